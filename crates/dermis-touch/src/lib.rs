//! dermis-touch
