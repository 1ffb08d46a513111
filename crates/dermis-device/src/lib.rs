//! dermis-device
