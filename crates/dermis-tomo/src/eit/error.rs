//! Why a forward problem, or the readout circuit around it, does not work.

use thiserror::Error;

use crate::sparse::SparseError;

/// Why a circuit does not fit a protocol or a skin.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum CircuitError {
    /// A channel that is no pair of electrodes driven and a pair read.
    #[error(
        "channel {channel}: its {what} has {entries} electrodes adding to {sum:e}; expected two of opposite weight"
    )]
    NotAPair {
        /// Which channel.
        channel: usize,
        /// `stimulation` or `measuring pattern`.
        what: &'static str,
        /// Electrodes with a weight.
        entries: usize,
        /// Sum of the weights.
        sum: f64,
    },
    /// A value that no circuit has.
    #[error("{field}: {value} is not {expected}")]
    Value {
        /// Which field.
        field: &'static str,
        /// The value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// No line leads to ground, so the potentials are undetermined, or two electrodes are one.
    #[error("channel {channel}: potentials are undetermined; expected a positive load on at least one line")]
    Floating {
        /// Which channel.
        channel: usize,
    },
    /// The skin has no admittance matrix.
    #[error("the transfer impedance is not positive definite; expected electrodes that share no node")]
    Impedance,
}

/// Why a forward problem could not be posed or solved.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum EitError {
    /// Mesh and protocol disagree, or there are too few electrodes.
    #[error("the mesh carries {mesh} electrodes, the protocol is for {protocol}; both must agree and be at least 2")]
    ElectrodeCount {
        /// Electrodes of the mesh.
        mesh: usize,
        /// Electrodes of the protocol.
        protocol: usize,
    },
    /// Wrong number of conductivities.
    #[error("conductivity: expected {expected} values (one an element), got {got}")]
    ConductivityCount {
        /// Elements.
        expected: usize,
        /// Values given.
        got: usize,
    },
    /// A conductivity that no passive material has.
    #[error("conductivity of element {element} is {value}; expected positive and finite")]
    Conductivity {
        /// Element index.
        element: usize,
        /// The value.
        value: f64,
    },
    /// Wrong number of channels.
    #[error("frame: expected {expected} values (one a channel), got {got}")]
    ChannelCount {
        /// Channels.
        expected: usize,
        /// Values given.
        got: usize,
    },
    /// A patch of contact that there cannot be.
    #[error("contact of radius {radius_m} m and {conductance_s_per_m2} S/m^2; expected both positive and finite")]
    Contact {
        /// Its radius.
        radius_m: f64,
        /// Its conductance per area.
        conductance_s_per_m2: f64,
    },
    /// A slit's edge that conducts as nothing does.
    #[error("joint {index} conducts {value} S/m; expected 0 or more, and finite")]
    Joint {
        /// Which of the edges.
        index: usize,
        /// Its conductance per length.
        value: f64,
    },
    /// Contacts were asked for on a body whose reference electrode is a point.
    #[error("contacts need electrodes with a contact impedance, and the last one is a point")]
    PointElectrode,
    /// The system could not be factored.
    #[error("forward problem: {0}")]
    System(#[from] SparseError),
    /// A readout circuit does not fit.
    #[error("readout circuit: {0}")]
    Circuit(#[from] CircuitError),
    /// A fit was asked for with parameters that make no sense.
    #[error(transparent)]
    Fit(#[from] crate::least_squares::Error),
}
