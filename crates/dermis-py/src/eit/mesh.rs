//! Meshes, electrodes on them, and pixel grids over them.

use std::sync::Arc;

use dermis_tomo::mesh::{CellKind, Contact, Electrode, Mesh, PixelGrid, PixelMap};
use pyo3::prelude::*;
use pyo3::type_hint_subscript;
use pyo3::type_object::PyTypeInfo;

use crate::arrays::{Array1, Array2, ArrayDyn, Doubles, array1, array2, indices, read_only, shape_text};
use crate::errors::{Fault, Kind};
use crate::grid::PyGrid;
use crate::hints::{ArrayLike, ELLIPSIS, ElectrodeKind, Restorer, python_types};
use crate::work::run_sized;

python_types! {
    /// A tuple of electrodes.
    Electrodes = type_hint_subscript!(pyo3::types::PyTuple::TYPE_HINT, PyElectrode::TYPE_HINT, ELLIPSIS);
}

/// Nodes as an array, with two columns if all lie in the plane z = 0.
pub fn nodes_of<'py>(py: Python<'py>, mesh: &Mesh) -> PyResult<Array2<'py, f64>> {
    let nodes = mesh.nodes();
    let flat = mesh.kind() == CellKind::Triangle && nodes.iter().all(|node| node[2] == 0.0);
    let columns = if flat { 2 } else { 3 };
    let values = nodes.iter().flat_map(|node| node[..columns].iter().copied()).collect();
    read_only(array2(py, values, nodes.len(), columns)?)
}

/// Node indices of the elements as an array.
pub fn elements_of<'py>(py: Python<'py>, mesh: &Mesh) -> PyResult<Array2<'py, u32>> {
    let values = mesh.elements().flatten().copied().collect();
    read_only(array2(py, values, mesh.element_count(), mesh.kind().nodes_per_element())?)
}

/// Translates between the caller's node numbers and the model's, if some nodes belong to no element (points of a
/// drawing, centres of arcs). The model has no such nodes, and its own numbers are never exposed.
#[derive(Clone, Debug)]
pub struct Numbering {
    /// All nodes given by the caller.
    nodes: Vec<[f64; 3]>,
    /// The caller's number for each node of the mesh.
    given: Vec<u32>,
    /// The mesh's number for each of the caller's nodes; `u32::MAX` for nodes of no element.
    own: Vec<u32>,
}

impl Numbering {
    /// The numbering for these nodes and elements; `None` if every node is used.
    fn of(nodes: &[[f64; 3]], elements: &[u32]) -> Option<Self> {
        let mut own = vec![u32::MAX; nodes.len()];
        elements.iter().for_each(|&node| own[node as usize] = 0);
        let given: Vec<u32> = (0..nodes.len() as u32).filter(|&node| own[node as usize] == 0).collect();
        (given.len() < nodes.len()).then(|| {
            given.iter().enumerate().for_each(|(number, &node)| own[node as usize] = number as u32);
            Self { nodes: nodes.to_vec(), given, own }
        })
    }

    /// Converts an electrode to the mesh's numbers.
    pub fn to_mesh(&self, index: usize, electrode: &Electrode) -> Result<Electrode, Fault> {
        let number = |&node: &u32| match self.own.get(node as usize) {
            Some(&own) if own != u32::MAX => Ok(own),
            Some(_) => {
                let expected = "nodes of elements";
                Err(Fault::input(
                    &format!("electrode {index}"),
                    expected,
                    format!("node {node}, which belongs to no element"),
                ))
            }
            None => {
                let expected = format!("nodes 0 to {}", self.own.len() - 1);
                Err(Fault::input(&format!("electrode {index}"), expected, node))
            }
        };
        let contact = match &electrode.contact {
            Contact::Faces(faces) => {
                let face = |face: &Vec<u32>| face.iter().map(number).collect::<Result<Vec<u32>, Fault>>();
                Contact::Faces(faces.iter().map(face).collect::<Result<Vec<Vec<u32>>, Fault>>()?)
            }
            Contact::Area(elements) => Contact::Area(elements.clone()),
            Contact::Point(node) => Contact::Point(number(node)?),
        };
        Ok(Electrode { contact, contact_impedance: electrode.contact_impedance })
    }

    /// Converts an electrode to the caller's numbers.
    pub fn to_caller(&self, electrode: &Electrode) -> Electrode {
        let number = |&node: &u32| self.given[node as usize];
        let contact = match &electrode.contact {
            Contact::Faces(faces) => {
                Contact::Faces(faces.iter().map(|face| face.iter().map(number).collect()).collect())
            }
            Contact::Area(elements) => Contact::Area(elements.clone()),
            Contact::Point(node) => Contact::Point(number(node)),
        };
        Electrode { contact, contact_impedance: electrode.contact_impedance }
    }

    /// Values per node in the caller's numbering, NaN at nodes of no element.
    pub fn values_to_caller(&self, values: &[f64]) -> Vec<f64> {
        self.own.iter().map(|&own| values.get(own as usize).copied().unwrap_or(f64::NAN)).collect()
    }
}

/// A mesh of triangles or tetrahedra: connected, without folds.
///
/// Nodes keep the numbers they are given, even if some belong to no element.
///
/// Parameters
/// ----------
/// nodes : array_like
///     Shape (n, 2) or (n, 3), metres.
/// elements : array_like
///     Shape (m, 3) or (m, 4), indices of nodes from 0, in any orientation.
///
/// Raises
/// ------
/// InputError
///     The mesh is invalid; the message names the fault.
#[pyclass(frozen, module = "dermis.eit", name = "Mesh")]
pub struct PyMesh {
    /// The mesh, checked.
    pub mesh: Arc<Mesh>,
    /// The caller's node numbers, if they differ from the mesh's own.
    pub numbering: Option<Arc<Numbering>>,
}

impl PyMesh {
    /// Converts node indices to the caller's numbers.
    fn given(&self, nodes: impl Iterator<Item = u32>) -> Vec<u32> {
        match &self.numbering {
            Some(numbering) => nodes.map(|node| numbering.given[node as usize]).collect(),
            None => nodes.collect(),
        }
    }
}

#[pymethods]
impl PyMesh {
    #[new]
    fn new(py: Python<'_>, nodes: ArrayLike<'_>, elements: ArrayLike<'_>) -> PyResult<Self> {
        let nodes = Doubles::of("nodes", &nodes)?;
        let &[count, columns @ (2 | 3)] = nodes.shape() else {
            return Err(Fault::input("nodes", "shape (n, 2) or (n, 3)", shape_text(nodes.shape())).into());
        };
        let (list, shape) = indices("elements", &elements, count, "nodes")?;
        let &[_, corners @ (3 | 4)] = shape.as_slice() else {
            return Err(Fault::input("elements", "shape (m, 3) or (m, 4)", shape_text(&shape)).into());
        };
        if corners == 4 && columns == 2 {
            return Err(Fault::input("nodes", "shape (n, 3) with elements of four nodes", "shape (n, 2)").into());
        }
        let kind = if corners == 3 { CellKind::Triangle } else { CellKind::Tetrahedron };
        let point = |row: &[f64]| [row[0], row[1], row.get(2).copied().unwrap_or(0.0)];
        let points: Vec<[f64; 3]> = nodes.values()?.chunks_exact(columns).map(point).collect();
        let size = (points.len() + list.len()) as f64;
        let (mesh, numbering) = run_sized(py, "mesh", PER_INDEX * size, move || {
            let Some(numbering) = Numbering::of(&points, &list) else {
                return Ok((Arc::new(Mesh::new(kind, points, list)?), None));
            };
            let used = numbering.given.iter().map(|&node| points[node as usize]).collect();
            let elements = list.iter().map(|&node| numbering.own[node as usize]).collect();
            Ok((Arc::new(Mesh::new(kind, used, elements)?), Some(Arc::new(numbering))))
        })?;
        Ok(Self { mesh, numbering })
    }

    /// Shape (n, 2) for flat meshes, otherwise (n, 3), metres. Read-only.
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let Some(numbering) = &self.numbering else { return nodes_of(py, &self.mesh) };
        let flat = self.mesh.kind() == CellKind::Triangle && numbering.nodes.iter().all(|node| node[2] == 0.0);
        let columns = if flat { 2 } else { 3 };
        let values = numbering.nodes.iter().flat_map(|node| node[..columns].iter().copied()).collect();
        read_only(array2(py, values, numbering.nodes.len(), columns)?)
    }

    /// Shape (m, 3) or (m, 4), from 0. Read-only.
    #[getter]
    fn elements<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, u32>> {
        let values = self.given(self.mesh.elements().flatten().copied());
        read_only(array2(py, values, self.mesh.element_count(), self.mesh.kind().nodes_per_element())?)
    }

    /// Area or volume of every element, shape (m,).
    #[getter]
    fn measures<'py>(&self, py: Python<'py>) -> Array1<'py, f64> {
        array1(py, self.mesh.measures().to_vec())
    }

    /// Centres of the elements, shape (m, 3), metres.
    #[getter]
    fn centroids<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let count = self.mesh.element_count();
        array2(py, (0..count).flat_map(|element| self.mesh.centroid(element)).collect(), count, 3)
    }

    /// Faces that belong to a single element, shape (p, 2) or (p, 3).
    #[getter]
    fn boundary_faces<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, u32>> {
        let faces = self.mesh.boundary_faces();
        let columns = self.mesh.kind().nodes_per_face();
        array2(py, self.given(faces.iter().flat_map(|(face, _)| face.iter().copied())), faces.len(), columns)
    }

    /// Pairs of elements that share a face, shape (p, 2).
    #[getter]
    fn neighbours<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, u32>> {
        let pairs = self.mesh.neighbours();
        array2(py, pairs.as_flattened().to_vec(), pairs.len(), 2)
    }

    /// A grid of pixels over the mesh.
    ///
    /// Parameters
    /// ----------
    /// pixels : int
    ///     Number of pixels along the longer side, at most 4096.
    #[pyo3(signature = (pixels=64))]
    fn grid(&self, py: Python<'_>, pixels: usize) -> PyResult<PyGrid> {
        if !(1..=MOST_PIXELS).contains(&pixels) {
            return Err(Fault::input("pixels", format!("1 to {MOST_PIXELS} along the longer side"), pixels).into());
        }
        let mesh = Arc::clone(&self.mesh);
        let size = (pixels * pixels + mesh.element_count()) as f64;
        let map = run_sized(py, "grid", PER_PIXEL * size, move || {
            dermis_tomo::memory::check(PIXEL_BYTES * size, || format!("a grid of {pixels} x {pixels} pixels"))
                .map_err(|error| Fault::new(Kind::Input, error.to_string()))?;
            Ok(PixelMap::new(PixelGrid::over_mesh(&mesh, pixels)?, &mesh)?)
        })?;
        Ok(PyGrid { map: Arc::new(map) })
    }

    fn __repr__(&self) -> String {
        let what = if self.mesh.kind() == CellKind::Triangle { "triangles" } else { "tetrahedra" };
        let nodes = self.numbering.as_ref().map_or(self.mesh.nodes().len(), |numbering| numbering.nodes.len());
        format!("<dermis.eit.Mesh: {nodes} nodes, {} {what}>", self.mesh.element_count())
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Restorer<'py>, (Array2<'py, f64>, Array2<'py, u32>))> {
        let (py, mesh) = (slf.py(), slf.get());
        Ok((Restorer(slf.get_type().into_any()), (mesh.nodes(py)?, mesh.elements(py)?)))
    }
}

/// An electrode: the part of the mesh that it touches, and its contact impedance.
#[pyclass(frozen, module = "dermis.eit", name = "Electrode")]
pub struct PyElectrode {
    /// The electrode in the form that the mesh takes.
    pub electrode: Electrode,
}

/// Operations for checking a mesh, per index, and for overlaying it with pixels, per pixel and element.
const PER_INDEX: f64 = 500.0;
const PER_PIXEL: f64 = 300.0;
/// Bytes per pixel while a mesh is overlaid: coverage, numbers, shares, weights.
const PIXEL_BYTES: f64 = 150.0;
/// Maximum number of pixels along the longer side of a grid: more would not fit in memory.
const MOST_PIXELS: usize = 4096;
/// Node indices are checked later, against the mesh that the electrode is put on.
const ANY: usize = u32::MAX as usize;

fn faces(what: &str, nodes: &Bound<'_, PyAny>, columns: usize) -> PyResult<Vec<Vec<u32>>> {
    let (list, shape) = indices(what, nodes, ANY, "nodes")?;
    if shape.len() != 2 || shape[1] != columns {
        return Err(Fault::input(what, format!("shape (p, {columns})"), shape_text(&shape)).into());
    }
    Ok(list.chunks_exact(columns).map(<[u32]>::to_vec).collect())
}

impl PyElectrode {
    fn kind_name(&self) -> &'static str {
        match &self.electrode.contact {
            Contact::Faces(faces) if faces.first().is_some_and(|face| face.len() == 3) => "faces",
            Contact::Faces(_) => "edges",
            Contact::Area(_) => "elements",
            Contact::Point(_) => "point",
        }
    }
}

#[pymethods]
impl PyElectrode {
    /// An electrode on edges of a flat mesh.
    ///
    /// Parameters
    /// ----------
    /// nodes : array_like
    ///     Shape (p, 2): the two nodes of every edge, from 0.
    /// contact_impedance : float
    ///     Contact impedance, ohm.m.
    ///
    /// Returns
    /// -------
    /// Electrode
    #[staticmethod]
    fn edges(nodes: ArrayLike<'_>, contact_impedance: f64) -> PyResult<Self> {
        let contact = Contact::Faces(faces("edges", &nodes, 2)?);
        Ok(Self { electrode: Electrode { contact, contact_impedance } })
    }

    /// An electrode on faces of a solid.
    ///
    /// Parameters
    /// ----------
    /// nodes : array_like
    ///     Shape (p, 3): the three nodes of every face, from 0.
    /// contact_impedance : float
    ///     Contact impedance, ohm.m^2.
    ///
    /// Returns
    /// -------
    /// Electrode
    #[staticmethod]
    #[pyo3(name = "faces")]
    fn of_faces(nodes: ArrayLike<'_>, contact_impedance: f64) -> PyResult<Self> {
        let contact = Contact::Faces(faces("faces", &nodes, 3)?);
        Ok(Self { electrode: Electrode { contact, contact_impedance } })
    }

    /// A pad under elements of a sheet.
    ///
    /// Parameters
    /// ----------
    /// elements : array_like
    ///     Shape (p,): the elements, from 0.
    /// contact_impedance : float
    ///     Contact impedance, ohm.m^2.
    ///
    /// Returns
    /// -------
    /// Electrode
    #[staticmethod]
    fn elements(elements: ArrayLike<'_>, contact_impedance: f64) -> PyResult<Self> {
        let (list, shape) = indices("elements", &elements, ANY, "elements")?;
        if shape.len() != 1 {
            return Err(Fault::input("elements", "shape (p,)", shape_text(&shape)).into());
        }
        Ok(Self { electrode: Electrode { contact: Contact::Area(list), contact_impedance } })
    }

    /// An electrode at a node, without contact impedance.
    #[staticmethod]
    fn point(node: u32) -> Self {
        Self { electrode: Electrode { contact: Contact::Point(node), contact_impedance: 0.0 } }
    }

    /// ``edges``, ``faces``, ``elements`` or ``point``.
    #[getter]
    fn kind(&self) -> ElectrodeKind {
        ElectrodeKind::of(self.kind_name())
    }

    /// Nodes of its edges, shape (p, 2), or faces, shape (p, 3); its elements, shape (p,); or its node, shape (1,).
    #[getter]
    fn parts<'py>(&self, py: Python<'py>) -> PyResult<ArrayDyn<'py, u32>> {
        Ok(match &self.electrode.contact {
            Contact::Faces(faces) => {
                let columns = faces.first().map_or(2, Vec::len);
                array2(py, faces.concat(), faces.len(), columns)?.into_dyn()
            }
            Contact::Area(elements) => array1(py, elements.clone()).into_dyn(),
            Contact::Point(node) => array1(py, vec![*node]).into_dyn(),
        })
    }

    /// Contact impedance: ohm.m on edges, ohm.m^2 on faces and elements, 0 for a point.
    #[getter]
    fn contact_impedance(&self) -> f64 {
        self.electrode.contact_impedance
    }

    fn __repr__(&self) -> String {
        let count = match &self.electrode.contact {
            Contact::Faces(faces) => faces.len(),
            Contact::Area(elements) => elements.len(),
            Contact::Point(_) => 1,
        };
        format!("<dermis.eit.Electrode: {count} {}, z {}>", self.kind_name(), self.electrode.contact_impedance)
    }
}
