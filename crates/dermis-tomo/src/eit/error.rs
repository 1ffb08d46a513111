//! Errors of a forward problem and of the readout circuit around it.

use thiserror::Error;

use crate::sparse::SparseError;

/// Reasons why a circuit does not fit a protocol or a skin.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum CircuitError {
    /// A channel that is not a driven pair and a read pair.
    #[error(
        "channel {channel}: its {what} has {entries} electrodes adding to {sum:e}; expected two of opposite weight"
    )]
    NotAPair {
        /// Channel index.
        channel: usize,
        /// `stimulation` or `measuring pattern`.
        what: &'static str,
        /// Number of electrodes with a weight.
        entries: usize,
        /// Sum of the weights.
        sum: f64,
    },
    /// A value that is not valid for a circuit.
    #[error("{field}: {value} is not {expected}")]
    Value {
        /// Name of the field.
        field: &'static str,
        /// The value.
        value: f64,
        /// Expected values.
        expected: &'static str,
    },
    /// No line leads to ground, so the potentials are undetermined, or two electrodes coincide.
    #[error("channel {channel}: potentials are undetermined; expected a positive load on at least one line")]
    Floating {
        /// Channel index.
        channel: usize,
    },
    /// The skin has no admittance matrix.
    #[error("the transfer impedance is not positive definite; expected electrodes that share no node")]
    Impedance,
}

/// Reasons why a forward problem cannot be posed or solved.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum EitError {
    /// Mesh and protocol disagree, or there are too few electrodes.
    #[error("the mesh carries {mesh} electrodes, the protocol is for {protocol}; both must agree and be at least 2")]
    ElectrodeCount {
        /// Number of electrodes in the mesh.
        mesh: usize,
        /// Number of electrodes in the protocol.
        protocol: usize,
    },
    /// Wrong number of conductivities.
    #[error("conductivity: expected {expected} values (one per element), got {got}")]
    ConductivityCount {
        /// Number of elements.
        expected: usize,
        /// Number of values given.
        got: usize,
    },
    /// A conductivity that is not positive and finite.
    #[error("conductivity of element {element} is {value}; expected positive and finite")]
    Conductivity {
        /// Element index.
        element: usize,
        /// The value.
        value: f64,
    },
    /// Wrong number of channels.
    #[error("frame: expected {expected} values (one per channel), got {got}")]
    ChannelCount {
        /// Number of channels.
        expected: usize,
        /// Number of values given.
        got: usize,
    },
    /// A patch of contact with an invalid radius or conductance.
    #[error("contact of radius {radius_m} m and {conductance_s_per_m2} S/m^2; expected both positive and finite")]
    Contact {
        /// Radius of the patch.
        radius_m: f64,
        /// Conductance per area of the patch.
        conductance_s_per_m2: f64,
    },
    /// A slit edge with an invalid conductance.
    #[error("joint {index} conducts {value} S/m; expected 0 or more, and finite")]
    Joint {
        /// Index of the edge.
        index: usize,
        /// Conductance per length.
        value: f64,
    },
    /// Contacts on a body whose reference electrode is a point.
    #[error("contacts need electrodes with a contact impedance, and the last one is a point")]
    PointElectrode,
    /// The system could not be factored.
    #[error("forward problem: {0}")]
    System(#[from] SparseError),
    /// A readout circuit does not fit.
    #[error("readout circuit: {0}")]
    Circuit(#[from] CircuitError),
    /// A fit with invalid parameters.
    #[error(transparent)]
    Fit(#[from] crate::least_squares::Error),
}
