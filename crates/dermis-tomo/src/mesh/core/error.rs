//! Errors of meshes and their electrodes.

use thiserror::Error;

/// Reasons to refuse a mesh or an electrode on it.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum MeshError {
    /// A list has the wrong length.
    #[error("{what}: expected {expected}, got {got}")]
    Count {
        /// The items counted.
        what: &'static str,
        /// Expected count, in words or as a number.
        expected: String,
        /// Count found.
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
    /// An element or electrode names a node that does not exist.
    #[error("{what} {index} names node {node}, but there are only {node_count} nodes")]
    NodeOutOfRange {
        /// `element` or `electrode`.
        what: &'static str,
        /// Index of the element or electrode.
        index: usize,
        /// Index of the node.
        node: usize,
        /// Number of nodes.
        node_count: usize,
    },
    /// An element has (almost) no area or volume.
    #[error("element {element} is degenerate: measure {measure:e} (m^2 or m^3) where the mean is {mean:e}")]
    Degenerate {
        /// Element index.
        element: usize,
        /// Area or volume of the element.
        measure: f64,
        /// Mean area or volume.
        mean: f64,
    },
    /// Elements overlap: more than two share a face.
    #[error("face {nodes:?} is shared by {count} elements; at most 2 can meet there")]
    Overlapping {
        /// The nodes of the face.
        nodes: Vec<u32>,
        /// Number of elements that share it.
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
    /// The mesh has parts that are not connected, so no current can pass between them.
    #[error("the mesh is disconnected: {parts} parts; node {node} cannot be reached from node {from}")]
    Disconnected {
        /// Number of parts.
        parts: usize,
        /// A node of another part.
        node: usize,
        /// The node where the search started.
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
        /// The problem, with the value.
        reason: String,
    },
    /// The shape itself is invalid.
    #[error("{field}: {value} is not {expected}")]
    Shape {
        /// Name of the parameter.
        field: &'static str,
        /// Its value.
        value: String,
        /// Expected values.
        expected: String,
    },
    /// Text that is not a valid mesh.
    #[error("line {line}: {reason}")]
    Parse {
        /// One-based line number.
        line: usize,
        /// Found and expected content.
        reason: String,
    },
}
