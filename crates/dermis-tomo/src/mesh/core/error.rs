//! What makes a mesh, or an electrode on it, be refused.

use thiserror::Error;

/// Why a mesh, or an electrode on it, was refused.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum MeshError {
    /// A list's length does not fit.
    #[error("{what}: expected {expected}, got {got}")]
    Count {
        /// What was counted.
        what: &'static str,
        /// What was expected, in words or a number.
        expected: String,
        /// What was found.
        got: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("node {node}: coordinate {value} is not finite")]
    NotFinite {
        /// Node index.
        node: usize,
        /// The offending value.
        value: f64,
    },
    /// An element or face names a node that does not exist.
    #[error("{what} {index} names node {node}, but there are only {node_count} nodes")]
    NodeOutOfRange {
        /// `element` or `electrode`.
        what: &'static str,
        /// Its index.
        index: usize,
        /// The node named.
        node: usize,
        /// How many nodes there are.
        node_count: usize,
    },
    /// An element has (almost) no area or volume.
    #[error("element {element} is degenerate: measure {measure:e} (m^2 or m^3) where the mean is {mean:e}")]
    Degenerate {
        /// Element index.
        element: usize,
        /// Its area or volume.
        measure: f64,
        /// Mean area or volume.
        mean: f64,
    },
    /// Elements overlap: a face is shared by more than two of them.
    #[error("face {nodes:?} is shared by {count} elements; at most 2 can meet there")]
    Overlapping {
        /// The nodes of the face.
        nodes: Vec<u32>,
        /// How many elements share it.
        count: usize,
    },
    /// Two elements that share a face lie on the same side of it.
    #[error("elements {first} and {second} fold over each other at face {nodes:?}: one of them is inverted")]
    Folded {
        /// One element.
        first: usize,
        /// The other.
        second: usize,
        /// The shared face.
        nodes: Vec<u32>,
    },
    /// The mesh falls into parts that no current can pass between.
    #[error("the mesh is disconnected: {parts} parts; node {node} cannot be reached from node {from}")]
    Disconnected {
        /// Number of parts.
        parts: usize,
        /// A node of another part.
        node: usize,
        /// The node the search began at.
        from: usize,
    },
    /// A node belongs to no element.
    #[error("node {node} belongs to no element")]
    Orphan {
        /// Node index.
        node: usize,
    },
    /// An electrode does not fit the mesh or its neighbours.
    #[error("electrode {electrode}: {reason}")]
    Electrode {
        /// Electrode index, zero-based.
        electrode: usize,
        /// What is wrong, with the value.
        reason: String,
    },
    /// The shape itself makes no sense.
    #[error("{field}: {value} is not {expected}")]
    Shape {
        /// Which parameter.
        field: &'static str,
        /// Its value.
        value: String,
        /// What was expected.
        expected: String,
    },
    /// Text that should hold a mesh does not.
    #[error("line {line}: {reason}")]
    Parse {
        /// One-based line number.
        line: usize,
        /// What was found and what was expected.
        reason: String,
    },
}
