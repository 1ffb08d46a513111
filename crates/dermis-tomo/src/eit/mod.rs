//! Electrical impedance tomography forward models.
