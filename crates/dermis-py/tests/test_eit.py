"""Meshes of other packages, the derivatives, operators and figures of merit."""

import numpy as np
import pytest

import dermis
from dermis import eit


def square(size=9):
    """A 1 m square with its nodes row by row, and point electrodes at its corners and the centres of its sides."""
    axis = np.linspace(0.0, 1.0, size)
    nodes = np.array([(x, y) for y in axis for x in axis])
    at = lambda row, column: row * size + column
    elements = []
    for row in range(size - 1):
        for column in range(size - 1):
            a, b, c, d = at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)
            elements += [(a, b, c), (a, c, d)]
    last, half = size - 1, size // 2
    rim = [at(0, 0), at(0, half), at(0, last), at(half, last), at(last, last), at(last, half), at(last, 0), at(half, 0)]
    return nodes, np.array(elements), rim


@pytest.fixture(scope="module")
def model():
    nodes, elements, rim = square()
    return eit.ForwardModel(eit.Mesh(nodes, elements), eit.points(rim), eit.Protocol.adjacent(8))


@pytest.fixture(scope="module")
def sigma(model):
    return np.random.default_rng(3).uniform(0.5, 2.0, len(model.mesh.elements))


def test_vjp_is_the_transposed_jacobian(model, sigma, random):
    cotangent = random.normal(size=model.protocol.channel_count)
    expected = model.jacobian(sigma).T @ cotangent
    # The same products are summed in another order.
    np.testing.assert_allclose(model.vjp(sigma, cotangent), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_vjp_against_differences(model, sigma, random):
    cotangent = random.normal(size=model.protocol.channel_count)
    gradient = model.vjp(sigma, cotangent)
    for element in random.choice(len(sigma), 12, replace=False):
        step = np.zeros_like(sigma)
        # Steps of the cube root of the rounding error leave about 1e-10 of the value; compare relative to the largest
        # gradients.
        step[element] = 6e-6 * sigma[element]
        above, below = model.voltages(sigma + step), model.voltages(sigma - step)
        slope = cotangent @ (above - below) / (2 * step[element])
        assert abs(slope - gradient[element]) < 1e-7 * np.abs(gradient).max()


def test_vjp_of_skins(disc, random):
    """Skins with pads or rim electrodes under the complete electrode model, including single-ended readings."""
    for of in (disc, dermis.Skin("piezo-square").model(elements=800)):
        sigma = of.sigma * random.uniform(0.7, 1.4, len(of.sigma))
        cotangent = random.normal(size=len(of.voltages()))
        if of.skin.name == "piezo-square":
            # The derivative of readings behind a circuit is that of its patterns at this conductivity, as in J.
            expected = of.jacobian(sigma).T @ cotangent
        else:
            expected = of.jacobian(sigma).T @ cotangent
        got = of.vjp(sigma, cotangent)
        np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


def test_many_are_one_by_one(model, random):
    sigmas = random.uniform(0.5, 2.0, (300, len(model.mesh.elements)))
    many = model.voltages_many(sigmas, threads=2)
    np.testing.assert_array_equal(many, model.voltages_many(sigmas))
    for row in (0, 255, 256, 299):
        np.testing.assert_array_equal(many[row], model.voltages(sigmas[row]))


def test_reciprocity_and_potentials(model, sigma):
    impedance = model.transfer_impedance(sigma)
    np.testing.assert_allclose(impedance, impedance.T, rtol=1e-10, atol=1e-14)
    potentials = model.electrode_potentials(sigma, 2)
    assert abs(potentials.sum()) < 1e-12
    nodes = model.node_potentials(sigma, 2)
    rim = [electrode.parts[0] for electrode in model.electrodes]
    np.testing.assert_allclose(nodes[rim] - nodes[rim].mean(), potentials, atol=1e-12)
    with pytest.raises(dermis.InputError, match="stimulation: expected 0 to 7, got 99"):
        model.node_potentials(sigma, 99)


def test_protocols():
    protocol = eit.Protocol.adjacent(16)
    assert protocol.channel_count == 208 and protocol.channels.shape == (208, 4)
    assert protocol.channels[0].tolist() == [0, 1, 2, 3] and protocol.labels[0] == "1-2 > 3-4"
    listed = eit.Protocol(protocol.stimulations, protocol.measurements, protocol.stimulation_of)
    np.testing.assert_array_equal(listed.channels, protocol.channels)
    pairs = eit.Protocol.generate(8, [(0, 4), (1, 5)], [(2, 3), (6, 7)])
    assert pairs.channel_count == 4 and pairs.channels[-1].tolist() == [1, 5, 6, 7]
    assert eit.Protocol.generate(16, "pseudo-polar", "pseudo-polar").channel_count == 208
    assert eit.Protocol.generate(16, "skip-2", "skip-2").channel_count > 0


def test_operators(model, sigma):
    jacobian = model.jacobian(np.ones_like(sigma))
    change = np.zeros_like(sigma)
    change[40] = 0.1
    difference = model.voltages(1.0 + change) - model.voltages(np.ones_like(sigma))
    for prior in (eit.Prior.identity(), eit.Prior.noser(), eit.Prior.laplace(), eit.Prior.gaussian(0.1), eit.Prior.balanced(0.1)):
        operator = eit.Operator(jacobian, prior, ("relative", 1e-4), mesh=model.mesh)
        image = operator(difference)
        np.testing.assert_allclose(operator.matrix @ difference, image, rtol=1e-9, atol=1e-12 * np.abs(image).max())
        assert image.shape == sigma.shape and operator(np.stack([difference] * 3)).shape == (3, len(sigma))
        assert operator.posterior_deviation().shape == sigma.shape
    plain = eit.Operator(jacobian, eit.Prior.identity(), 0.01)
    expected = np.linalg.solve(jacobian.T @ jacobian + 1e-4 * np.eye(len(sigma)), jacobian.T @ difference)
    np.testing.assert_allclose(plain(difference), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    weighed = eit.Operator(jacobian, eit.Prior.identity(), 0.01, noise=np.full(len(difference), 0.5))
    np.testing.assert_allclose(weighed.matrix, plain.at(0.005).matrix, rtol=1e-6, atol=1e-9)
    for rule in ("l-curve", "gcv", ("known-noise", 1.0)):
        assert plain.at(rule, data=difference).hyperparameter > 0
    assert plain.at(("noise-figure", 0.9), signal=difference).hyperparameter > 0
    with pytest.raises(dermis.InputError, match="which this prior needs"):
        eit.Operator(jacobian, eit.Prior.laplace(), 1.0)
    with pytest.raises(dermis.InputError, match="hyperparameter"):
        eit.Operator(jacobian, eit.Prior.identity(), "large")
    with pytest.raises(dermis.InputError, match="positive"):
        eit.Operator(jacobian, eit.Prior.identity(), -1.0)


def test_figures_of_merit(model):
    """A disc drawn in the right place has no position error, no ringing, and an amplitude response of 1."""
    grid = model.mesh.grid(64)
    x, y = np.moveaxis(grid.centres_m, -1, 0)
    inside = np.hypot(x - 0.6, y - 0.5) < 0.15
    figures = eit.greit_figures(np.where(inside, 2.0, 0.0), grid, (0.6, 0.5), np.pi * 0.15**2, 2.0)
    # A disc of about 300 pixels.
    assert abs(figures["amplitude_response"] - 1.0) < 0.03 and figures["position_error_m"] < 0.01
    assert figures["ringing"] == 0.0 and figures["shape_deformation"] < 0.05


def test_meshes_of_other_packages():
    nodes, elements, _ = square()

    class PyEit:
        node, element = np.column_stack([nodes, np.zeros(len(nodes))]), elements

    class Eidors:
        pass

    Eidors.nodes, Eidors.elems = nodes, elements + 1
    for mesh in (PyEit, Eidors, {"nodes": nodes, "elements": elements}):
        taken = eit.mesh_from(mesh)
        np.testing.assert_array_equal(taken.nodes, nodes)
        np.testing.assert_array_equal(taken.elements, elements)
    spare = eit.mesh_from({"nodes": np.vstack([nodes, [[5.0, 5.0]]]), "elements": elements})
    assert len(spare.nodes) == len(nodes) + 1
    np.testing.assert_array_equal(spare.elements, elements)
    with pytest.raises(dermis.InputError, match="meshio"):
        eit.mesh_from(3)


def test_nodes_keep_their_numbers_where_some_are_in_no_element():
    nodes, elements, sigma = square()
    corners = [0, 1, 2, 3]
    right = eit.ForwardModel(eit.Mesh(nodes, elements), eit.points(corners), eit.Protocol.adjacent(4))
    shifted = eit.mesh_from({"nodes": np.vstack([[[9.0, 9.0]], nodes]), "elements": np.asarray(elements) + 1})
    model = eit.ForwardModel(shifted, eit.points([1, 2, 3, 4]), eit.Protocol.adjacent(4))
    sigma = np.ones(len(elements))
    np.testing.assert_array_equal(model.voltages(sigma), right.voltages(sigma))
    assert [int(electrode.parts[0]) for electrode in model.electrodes] == [1, 2, 3, 4]
    potentials = model.node_potentials(sigma, 0)
    assert np.isnan(potentials[0]) and np.isfinite(potentials[1:]).all()
    assert model.mesh.boundary_faces.min() == 1
    with pytest.raises(dermis.InputError, match="node 0, which belongs to no element"):
        eit.ForwardModel(shifted, eit.points([0, 2, 3, 4]), eit.Protocol.adjacent(4))


def test_meshes_in_millimetres_are_asked_about():
    nodes, elements, _ = square()
    wide = {"nodes": 100.0 * np.asarray(nodes) / np.ptp(nodes), "elements": elements}
    with pytest.raises(dermis.InputError, match='use unit="mm"'):
        eit.mesh_from(wide)
    assert np.ptp(eit.mesh_from(wide, unit="mm").nodes) == pytest.approx(0.1)
    assert np.ptp(eit.mesh_from(wide, unit="m").nodes) == pytest.approx(100.0)


def test_meshio():
    meshio = pytest.importorskip("meshio")
    nodes, elements, _ = square()
    rim = [[0, 1]]
    mesh = meshio.Mesh(np.column_stack([nodes, 0 * nodes[:, 0]]), [("line", rim), ("triangle", elements)])
    np.testing.assert_array_equal(eit.mesh_from(mesh).elements, elements)
    tetra = meshio.Mesh(np.vstack([np.zeros(3), np.eye(3)]), [("tetra", [[0, 1, 2, 3]])])
    assert eit.mesh_from(tetra).elements.shape == (1, 4)


def test_eidors_structures(model, sigma):
    """A fwd_model as written by EIDORS, with indices from 1, becomes the same model."""

    class Record(dict):
        __getattr__ = dict.get

    protocol = model.protocol
    stimulations = []
    for number, row in enumerate(protocol.stimulations):
        reads = protocol.measurements[protocol.stimulation_of == number]
        stimulations.append(Record(stim_pattern=row[:, None], meas_pattern=reads))
    electrodes = [Record(nodes=[int(e.parts[0]) + 1], z_contact=0.01) for e in model.electrodes]
    fwd_model = Record(
        nodes=model.mesh.nodes, elems=model.mesh.elements.astype(int) + 1, electrode=electrodes, stimulation=stimulations
    )
    np.testing.assert_allclose(eit.pyeidors_model(fwd_model).voltages(sigma), model.voltages(sigma), rtol=1e-12)
    edges = model.mesh.boundary_faces[:2]
    other = [dict(electrodes[0]), Record(nodes=(edges[0] + 1).tolist(), z_contact=0.01)]
    assert other[1].nodes


def test_rings_of_electrodes():
    skin = dermis.Skin("hydrogel-disc")
    model = skin.model(elements=3000)
    mesh = eit.Mesh(model.nodes, model.elements)
    electrodes = eit.ring_electrodes(mesh, 8, 0.01, 0.01)
    assert len(electrodes) == 8 and all(electrode.kind == "edges" for electrode in electrodes)
    voltages = eit.ForwardModel(mesh, electrodes, eit.Protocol.adjacent(8)).voltages(model.sigma)
    assert np.isfinite(voltages).all()
    with pytest.raises(dermis.InputError, match="too coarse"):
        eit.ring_electrodes(mesh, 8, 1e-9, 0.01)


def test_coils_and_bodies():
    from dermis import mit

    # Two coaxial single turns: Maxwell's formula with complete elliptic integrals, evaluated with SciPy for this
    # pair.
    coils = mit.Coils([[0, 0, 0], [0, 0, 0.02]], inner_m=0.0198, outer_m=0.0202, turns=1)
    mutual = coils.mutuals_h()[0]
    a, d = 0.01, 0.02
    k2 = 4 * a * a / (4 * a * a + d * d)
    angle = (np.arange(20000) + 0.5) * np.pi / 2 / 20000
    root = np.sqrt(1 - k2 * np.sin(angle) ** 2)
    elliptic_k, elliptic_e = (np.pi / 2) * np.mean(1 / root), (np.pi / 2) * np.mean(root)
    k = np.sqrt(k2)
    expected = 4e-7 * np.pi * a * ((2 / k - k) * elliptic_k - 2 / k * elliptic_e)
    assert abs(mutual / expected - 1) < 1e-3
    ball = mit.Body.sphere(0.005, 5.8e7, 10e3)
    change = coils.changes_h(ball, (0.0, 0.03, 0.01))
    assert change.dtype == complex and np.isfinite(change).all()
    with pytest.raises(dermis.InputError, match="centre_m"):
        coils.changes_h(ball, (0.01, 0.0, 0.0))
    with pytest.raises(dermis.InputError):
        mit.Coils([[0, 0], [0.001, 0]], inner_m=0.01, outer_m=0.02, turns=5)
