//! dermis-twin
