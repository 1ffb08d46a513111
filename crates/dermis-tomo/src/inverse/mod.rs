//! Inverse operators.
