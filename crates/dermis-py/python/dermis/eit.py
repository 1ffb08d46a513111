"""Electrical impedance tomography on your own meshes: the parts of :class:`dermis.Model`, one by one.

Meshes are triangles (flat, or a surface in space) or tetrahedra. Electrodes are sets of edges, faces or elements
under the complete electrode model, or points. Signs and units follow EIDORS: current into the body is positive, ``J =
dv/dsigma``. On a flat mesh conductivities are sheet conductances (S), and contact impedances are ohm.m on edges and
ohm.m^2 on elements.

>>> import numpy as np
>>> from dermis import eit
>>> nodes = [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]]
>>> mesh = eit.Mesh(nodes, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
>>> points = [eit.Electrode.point(node) for node in range(4)]
>>> model = eit.ForwardModel(mesh, points, eit.Protocol.adjacent(4))
>>> model.voltages(np.ones(4)).shape
(4,)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ._dermis import Electrode, ForwardModel, Mesh, Operator, Prior, Protocol, greit_figures
from .errors import InputError

__all__ = [
    "Electrode",
    "ForwardModel",
    "Mesh",
    "Operator",
    "Prior",
    "Protocol",
    "greit_figures",
    "electrodes_at",
    "electrodes_from",
    "mesh_from",
    "points",
    "protocol_from_pyeit",
    "pyeidors_model",
    "pyeit_model",
    "ring_electrodes",
]


# The number of channels grows with the square of the electrodes: more would not fit into memory.
_MOST_ELECTRODES = 512


def points(nodes: Any) -> list[Electrode]:
    """Point electrodes at these nodes, in order."""
    return [Electrode.point(int(node)) for node in np.asarray(nodes).ravel()]


def mesh_from(mesh: Any, *, unit: str | None = None) -> Mesh:
    """Makes a mesh from another package's.

    Parameters
    ----------
    mesh : object
        A ``meshio.Mesh`` (``points`` and ``cells``; uses the tetrahedra if there are any, otherwise the triangles), a
        ``pyeit`` mesh (``node``, ``element``), an EIDORS or PyEIDORS ``fwd_model`` (``nodes``, ``elems`` from 1 or
        from 0), or a dictionary with such keys.
    unit : str, optional
        Unit of the coordinates: ``"m"``, ``"cm"``, ``"mm"`` or ``"um"``. The default is metres, but then a mesh wider
        than 5 m is rejected, since it is more likely in millimetres.

    Returns
    -------
    Mesh
        The mesh, with the original numbering of nodes and elements, even if some nodes belong to no element.

    Raises
    ------
    InputError
        The object is not a mesh, or it is wider than 5 m and no unit is given.
    """
    nodes, elements = _arrays_of(mesh)
    return Mesh(_metres(nodes, elements, unit), elements)


_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
# Wider than any tank, and narrower than a 10 mm skin drawn in millimetres.
_WIDEST_M = 5.0


def _metres(nodes: np.ndarray, elements: np.ndarray, unit: str | None) -> np.ndarray:
    if unit is not None:
        if unit not in _UNITS:
            raise InputError(f"unit: expected one of {', '.join(_UNITS)}, got {unit!r}")
        return nodes * _UNITS[unit]
    if nodes.ndim == 2 and elements.size and elements.min() >= 0 and elements.max() < len(nodes):
        width = float(np.ptp(nodes[np.unique(elements)], axis=0).max())
        if width > _WIDEST_M:
            raise InputError(
                f"mesh: {width:g} m wide: is it in millimetres? if so, use unit=\"mm\", else unit=\"m\""
            )
    return nodes


def electrodes_from(mesh: Any, prefix: str = "electrode", *, contact_impedance: Any) -> list[Electrode]:
    """Makes electrodes from the physical groups of a ``meshio.Mesh`` read from a Gmsh file.

    Parameters
    ----------
    mesh : meshio.Mesh
        A mesh with groups named by the prefix and a number: ``electrode_1``, ``electrode 2``, ``electrode3``.
        Groups of lines (of triangles, on a solid) become electrodes on edges (faces), groups of triangles in a flat
        mesh become pads, and a group of one point becomes a point electrode.
    prefix : str
        Prefix of the groups' names.
    contact_impedance : float or array_like
        One for all, or one each: ohm.m for edges, ohm.m^2 for faces and pads.

    Returns
    -------
    list of Electrode
        The electrodes in the order of their numbers, for the :class:`Mesh` that :func:`mesh_from` makes from the same
        file.

    Raises
    ------
    InputError
        There are no such groups, a number occurs twice, or groups cannot be electrodes.
    """
    names, cells, data = (_get(mesh, name) for name in ("field_data", "cells_dict", "cell_data_dict"))
    if names is None or cells is None or data is None:
        raise InputError(f"mesh: expected a meshio.Mesh of a Gmsh file, got {type(mesh).__name__}")
    tags = data.get("gmsh:physical", {})
    solid = len(cells.get("tetra", ())) > 0
    found: dict[int, tuple[str, int, int]] = {}
    for name, (tag, dimension) in names.items():
        number = name[len(prefix) :].strip("_- .") if name.startswith(prefix) else ""
        if not number.isdigit():
            continue
        if int(number) in found:
            raise InputError(f"mesh: expected one group for electrode {int(number)}, got {found[int(number)][0]} and {name}")
        found[int(number)] = (name, int(tag), int(dimension))
    if not found:
        given = ", ".join(map(str, names)) or "none"
        raise InputError(f"mesh: expected groups named {prefix}1, {prefix}2, ..., got {given}")
    missing = sorted(set(range(min(found), max(found) + 1)) - set(found))
    if missing:
        raise InputError(f"mesh: expected groups {prefix}{min(found)} to {prefix}{max(found)}, got none for {missing}")
    impedances = _each(contact_impedance, len(found))
    kinds = {0: "vertex", 1: "line", 2: "triangle"}
    electrodes = []
    for (_, (name, tag, dimension)), impedance in zip(sorted(found.items()), impedances, strict=True):
        kind = kinds.get(dimension, "tetra")
        members = np.asarray(tags.get(kind, ())) == tag
        parts = np.asarray(cells[kind])[members] if members.any() else np.empty((0, 0), int)
        if not len(parts):
            raise InputError(f"mesh: expected {kind} cells in group {name}, got none")
        if dimension == 0 and len(parts) == 1:
            electrodes.append(Electrode.point(int(parts[0, 0])))
        elif dimension == 2 and not solid:
            electrodes.append(Electrode.elements(np.flatnonzero(members), impedance))
        elif dimension == (2 if solid else 1):
            electrodes.append((Electrode.faces if solid else Electrode.edges)(parts, impedance))
        else:
            raise InputError(f"mesh: expected {'triangles' if solid else 'lines'} in group {name}, got {len(parts)} {kind} cells")
    return electrodes


def electrodes_at(mesh: Mesh, places_m: Any, width_m: Any, contact_impedance: Any) -> list[Electrode]:
    """Electrodes on the rim of a flat mesh, given by position.

    Each consists of the boundary edges whose centres lie within half a width, along the rim, of its point nearest to
    the given position.

    Parameters
    ----------
    mesh : Mesh
        A flat mesh.
    places_m : array_like
        Shape (n, 2): positions, metres.
    width_m : float or array_like
        Width of all electrodes or of each, metres.
    contact_impedance : float or array_like
        Contact impedance of all electrodes or of each, ohm.m.

    Returns
    -------
    list of Electrode
        The electrodes in the order of the positions.

    Raises
    ------
    InputError
        A position is farther than its width from every edge, or the mesh is too coarse for a width.
    """
    places = np.asarray(places_m, float)
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise InputError(f"places_m: expected shape (n, 2), got shape {places.shape}")
    nodes, edges = np.asarray(mesh.nodes)[:, :2], mesh.boundary_faces.astype(np.int64)
    if edges.shape[1] != 2:
        raise InputError("mesh: expected a flat mesh of triangles, got tetrahedra")
    starts, along = nodes[edges[:, 0]], nodes[edges[:, 1]] - nodes[edges[:, 0]]
    lengths = np.hypot(along[:, 0], along[:, 1])
    around: dict[int, list[int]] = {}
    for number, edge in enumerate(edges):
        for node in edge:
            around.setdefault(int(node), []).append(number)
    electrodes = []
    widths, impedances = _each(width_m, len(places)), _each(contact_impedance, len(places))
    for number, (place, width, impedance) in enumerate(zip(places, widths, impedances, strict=True)):
        share = np.clip(((place - starts) * along).sum(axis=1) / lengths**2, 0.0, 1.0)
        off = np.linalg.norm(starts + share[:, None] * along - place, axis=1)
        nearest = int(off.argmin())
        if off[nearest] > width:
            raise InputError(
                f"places_m: electrode {number}: expected a place at the rim, got {tuple(place)}, {off[nearest]:.3g} m from it"
            )
        # Distances of the edges' centres along the rim, in both directions from the nearest point.
        chosen = {nearest: abs(share[nearest] - 0.5) * lengths[nearest]}
        for end, gone in ((1, (1.0 - share[nearest]) * lengths[nearest]), (0, share[nearest] * lengths[nearest])):
            edge, node = nearest, int(edges[nearest, end])
            while gone <= 0.5 * width:
                others = [other for other in around[node] if other != edge]
                if len(others) != 1 or others[0] == nearest:
                    break
                edge = others[0]
                chosen[edge] = min(chosen.get(edge, np.inf), gone + 0.5 * lengths[edge])
                gone += lengths[edge]
                node = int(edges[edge].sum()) - node
        within = [edge for edge, distance in chosen.items() if distance <= 0.5 * width]
        if not within:
            raise InputError(f"electrode {number}: expected an edge within {width} m, got none; the mesh is too coarse")
        electrodes.append(Electrode.edges(edges[within], float(impedance)))
    return electrodes


def _each(values: Any, count: int) -> np.ndarray:
    values = np.asarray(values, float).ravel()
    if len(values) not in (1, count):
        raise InputError(f"expected one value for all electrodes or {count}, got {len(values)}")
    return np.broadcast_to(values, (count,))


def _get(mesh: Any, *names: str) -> Any:
    for name in names:
        value = mesh.get(name) if isinstance(mesh, dict) else getattr(mesh, name, None)
        if value is not None:
            return value
    return None


def _arrays_of(mesh: Any) -> tuple[np.ndarray, np.ndarray]:
    nodes = _get(mesh, "points", "node", "nodes")
    cells = _get(mesh, "cells_dict")
    if nodes is not None and cells is not None:
        for kind in ("tetra", "triangle"):
            if len(cells.get(kind, ())):
                return _flat(np.asarray(nodes, float), np.asarray(cells[kind], np.int64))
        raise InputError(f"mesh: expected cells of kind tetra or triangle, got {', '.join(cells) or 'none'}")
    elements = _get(mesh, "element", "elements", "elems")
    if nodes is None or elements is None:
        raise InputError(
            "mesh: expected points and cells (meshio), node and element (pyEIT), or nodes and elems (EIDORS, "
            f"PyEIDORS), got {type(mesh).__name__}"
        )
    nodes, elements = np.asarray(nodes, float), np.asarray(elements, np.int64)
    if elements.ndim == 2 and elements.size and elements.min() == 1 and elements.max() == len(nodes):
        elements = elements - 1
    return _flat(nodes, elements)


def _flat(nodes: np.ndarray, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drops a third coordinate that triangles don't need."""
    if nodes.ndim == 2 and nodes.shape[1] == 3 and elements.ndim == 2 and elements.shape[1] == 3:
        if len(nodes) and np.ptp(nodes[:, 2]) == 0.0:
            nodes = nodes[:, :2]
    return nodes, elements


def protocol_from_pyeit(protocol: Any, amplitude_a: float = 1.0) -> Protocol:
    """Converts a ``pyeit`` protocol object.

    pyEIT drives +1 into ``ex_mat[:, 0]`` and -1 into ``ex_mat[:, 1]``, and reads the potential of ``meas_mat[:, 0]``
    minus that of ``meas_mat[:, 1]``. A third column of ``meas_mat``, if present, holds the stimulation.

    Parameters
    ----------
    protocol : object
        An object with ``ex_mat`` and ``meas_mat``.
    amplitude_a : float
        Current, amperes; pyEIT's is 1.

    Returns
    -------
    Protocol
        The protocol, with channels in pyEIT's order.
    """
    drives = np.asarray(protocol.ex_mat, np.int64)
    reads = np.asarray(protocol.meas_mat, np.int64)
    if drives.ndim != 2 or drives.shape[1] != 2 or not len(drives):
        raise InputError(f"ex_mat: expected shape (s, 2), got {drives.shape}")
    if reads.ndim not in (2, 3) or reads.shape[-1] < 2 or not reads.size or (reads.ndim == 2 and reads.shape[1] != 3):
        expected = "shape (s, k, 2 or more), or (k, 3) with the stimulation in the third column"
        raise InputError(f"meas_mat: expected {expected}, got {reads.shape}")
    if min(drives.min(), reads.min()) < 0:
        raise InputError("ex_mat, meas_mat: expected indices from 0, got a negative one")
    if reads.ndim == 3:
        of = np.repeat(np.arange(reads.shape[0]), reads.shape[1])
        reads = reads.reshape(-1, reads.shape[2])
    else:
        of = reads[:, 2]
    count = int(getattr(protocol, "n_el", 1 + max(drives.max(), reads[:, :2].max())))
    most = max(drives.max(), reads[:, :2].max())
    if not most < count <= _MOST_ELECTRODES:
        raise InputError(f"n_el: expected {most + 1} to {_MOST_ELECTRODES} electrodes, got {count}")
    stimulations = np.zeros((len(drives), count))
    rows = np.arange(len(drives))
    np.add.at(stimulations, (rows, drives[:, 0]), amplitude_a)
    np.add.at(stimulations, (rows, drives[:, 1]), -amplitude_a)
    measurements = np.zeros((len(reads), count))
    rows = np.arange(len(reads))
    np.add.at(measurements, (rows, reads[:, 0]), 1.0)
    np.add.at(measurements, (rows, reads[:, 1]), -1.0)
    return Protocol(stimulations, measurements, of)


def pyeit_model(mesh: Any, protocol: Any, amplitude_a: float = 1.0) -> ForwardModel:
    """The forward model of a ``pyeit`` mesh and protocol, with pyEIT's own point electrodes (``el_pos``).

    Parameters
    ----------
    mesh, protocol : object
        Results of ``pyeit.mesh.create`` and ``pyeit.eit.protocol.create``.
    amplitude_a : float
        Current, amperes; pyEIT's is 1.

    Returns
    -------
    ForwardModel
        The model; its voltages equal those of ``EITForward.solve_eit``.
    """
    nodes, elements = _arrays_of(mesh)
    return ForwardModel(Mesh(nodes, elements), points(mesh.el_pos), protocol_from_pyeit(protocol, amplitude_a))


def pyeidors_model(fwd_model: Any) -> ForwardModel:
    """The forward model of an EIDORS or PyEIDORS ``fwd_model``.

    An electrode consists of the boundary faces between its ``nodes`` (a point if there is one node), with its
    ``z_contact``; stimulations are ``stimulation[i].stim_pattern`` (A) and ``.meas_pattern``. Indices are taken to
    count from 1, as EIDORS writes them, if the largest equals the number of nodes.
    """
    nodes, elements = _arrays_of(fwd_model)
    mesh = Mesh(nodes, elements)
    one_based = int(np.asarray(_get(fwd_model, "elems", "elements"), np.int64).max()) == len(nodes)
    boundary = mesh.boundary_faces.astype(np.int64)
    electrodes = []
    for electrode in _get(fwd_model, "electrode", "electrodes"):
        members = np.asarray(_get(electrode, "nodes"), np.int64).ravel() - int(one_based)
        if len(members) == 1:
            electrodes.append(Electrode.point(int(members[0])))
            continue
        faces = boundary[np.isin(boundary, members).all(axis=1)]
        impedance = float(_get(electrode, "z_contact"))
        make = Electrode.edges if faces.shape[1] == 2 else Electrode.faces
        electrodes.append(make(faces, impedance))
    stimulations: list[np.ndarray] = []
    measurements: list[np.ndarray] = []
    of: list[int] = []
    for number, stimulation in enumerate(_get(fwd_model, "stimulation", "stimulations")):
        stimulations.append(_dense(_get(stimulation, "stim_pattern")).ravel())
        rows = np.atleast_2d(_dense(_get(stimulation, "meas_pattern")))
        measurements.extend(rows)
        of.extend([number] * len(rows))
    return ForwardModel(mesh, electrodes, Protocol(stimulations, measurements, of))


def _dense(pattern: Any) -> np.ndarray:
    return np.asarray(pattern.toarray() if hasattr(pattern, "toarray") else pattern, float)


def ring_electrodes(mesh: Mesh, count: int, width_m: float, contact_impedance: float, *, start_rad: float = 0.0) -> list[Electrode]:
    """Electrodes at equal angles around a flat mesh's rim, counter-clockwise.

    Each consists of the boundary edges whose centres lie within half a width of its centre, along a circle through
    them. Edges are used as they are, so on a mesh that is coarse relative to the width the electrodes have other
    widths.

    Parameters
    ----------
    mesh : Mesh
        A flat mesh.
    count : int
        Number of electrodes.
    width_m : float
        Width of each, in the unit of the mesh's nodes.
    contact_impedance : float
        Contact impedance, ohm.m.
    start_rad : float
        Angle of the first, from +x.

    Returns
    -------
    list of Electrode
        The electrodes in order.
    """
    if not 1 <= count <= _MOST_ELECTRODES:
        raise InputError(f"count: expected 1 to {_MOST_ELECTRODES}, got {count}")
    nodes = np.asarray(mesh.nodes)[:, :2]
    edges = mesh.boundary_faces
    if edges.shape[1] != 2:
        raise InputError("mesh: expected a flat mesh of triangles, got tetrahedra")
    middles = nodes[edges].mean(axis=1) - nodes.mean(axis=0)
    angles, radii = np.arctan2(middles[:, 1], middles[:, 0]), np.hypot(middles[:, 0], middles[:, 1])
    electrodes = []
    for number in range(count):
        off = angles - start_rad - 2.0 * np.pi * number / count
        off = (off + np.pi) % (2.0 * np.pi) - np.pi
        chosen = edges[np.abs(off) * radii <= 0.5 * width_m]
        if not len(chosen):
            raise InputError(f"electrode {number}: expected an edge within {width_m} m, got none; the mesh is too coarse")
        electrodes.append(Electrode.edges(chosen, contact_impedance))
    return electrodes
