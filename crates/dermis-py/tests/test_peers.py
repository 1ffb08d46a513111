"""pyEIT's own examples repeated with the same mesh, the same point electrodes and the same numbers."""

import time

import numpy as np
import pytest

from dermis import eit

mesh_module = pytest.importorskip("pyeit.mesh", reason="pyEIT is not installed", exc_type=ImportError)


@pytest.fixture(scope="module")
def peers():
    from pyeit.eit import protocol
    from pyeit.eit.fem import EITForward

    mesh = mesh_module.create(16, h0=0.1)
    pattern = protocol.create(16, dist_exc=1, step_meas=1, parser_meas="std")
    return mesh, pattern, EITForward(mesh, pattern), eit.pyeit_model(mesh, pattern)


def seconds(work, least=0.2):
    times = []
    begun = time.perf_counter()
    while time.perf_counter() - begun < least or len(times) < 3:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def test_forward(peers, capsys):
    mesh, _, theirs, ours = peers
    rng = np.random.default_rng(5)
    for sigma in (np.ones(len(mesh.element)), rng.uniform(0.5, 2.0, len(mesh.element))):
        expected = np.asarray(theirs.solve_eit(perm=sigma)).ravel()
        got = ours.voltages(sigma)
        # Both solve the same linear equations in double precision.
        assert np.linalg.norm(got - expected) < 1e-6 * np.linalg.norm(expected)
    ratio = seconds(lambda: theirs.solve_eit(perm=sigma)) / seconds(lambda: ours.voltages(sigma))
    with capsys.disabled():
        print(f"\nforward, {len(mesh.element)} elements: pyEIT takes {ratio:.0f} times as long")


def test_jacobian(peers, capsys):
    mesh, _, theirs, ours = peers
    sigma = np.ones(len(mesh.element))
    expected, _ = theirs.compute_jac(perm=sigma)
    got = ours.jacobian(sigma)
    # pyEIT's Jacobian is for +u on every element, which has the opposite sign of EIDORS' derivative.
    signed = min((np.linalg.norm(s * got - expected) / np.linalg.norm(expected), s) for s in (1.0, -1.0))
    assert signed[0] < 1e-6
    ratio = seconds(lambda: theirs.compute_jac(perm=sigma)) / seconds(lambda: ours.jacobian(sigma))
    with capsys.disabled():
        print(f"\nJacobian, {len(mesh.element)} elements: pyEIT takes {ratio:.0f} times as long")


@pytest.mark.parametrize(
    ("method", "prior"),
    [("dgn", eit.Prior.identity()), ("lm", eit.Prior.noser(1.0)), ("kotre", eit.Prior.noser(0.5))],
)
def test_gauss_newton_step(peers, method, prior, capsys):
    """pyEIT's JAC is the one-step solution with its lambda the square of ours; `lm` and `kotre` weight by J'J's
    diagonal."""
    from pyeit.eit import jac

    mesh, pattern, theirs, ours = peers
    solver = jac.JAC(mesh, pattern)
    solver.setup(p=0.5, lamb=0.01, method=method, jac_normalized=False)
    sigma = np.ones(len(mesh.element))
    changed = sigma.copy()
    changed[10:20] = 2.0
    v0, v1 = ours.voltages(sigma), ours.voltages(changed)
    image = np.real(solver.solve(v1, v0, normalize=False))
    step = eit.Operator(ours.jacobian(sigma), prior, np.sqrt(0.01))(v1 - v0)
    # Equal except for the sign of its Jacobian.
    assert min(np.linalg.norm(s * step - image) for s in (1.0, -1.0)) < 1e-6 * np.linalg.norm(image)
    setup = {"p": 0.5, "lamb": 0.01, "method": method, "jac_normalized": False}
    ratio = seconds(lambda: solver.setup(**setup)) / seconds(lambda: eit.Operator(ours.jacobian(sigma), prior, np.sqrt(0.01)))
    with capsys.disabled():
        print(f"\nJAC {method}, {len(mesh.element)} elements: pyEIT takes {ratio:.0f} times as long")


def test_greit(peers, capsys):
    """pyEIT's GREIT, `W' J' (JJ' + l diag(JJ')^p)^-1` on differences relative to the reference, equals our one-step
    solution on its own grid, with the identity as prior and channel noise proportional to the norms of the rows."""
    from pyeit.eit.greit import GREIT

    mesh, pattern, _, ours = peers
    solver = GREIT(mesh, pattern)
    lamb, p = 0.01, 0.5
    solver.setup(p=p, lamb=lamb, perm=1, jac_normalized=True)
    sigma = np.ones(len(mesh.element))
    changed = sigma.copy()
    changed[10:20] = 2.0
    v0, v1 = ours.voltages(sigma), ours.voltages(changed)
    expected = np.real(solver.solve(v1, v0, normalize=True))
    weights = solver._compute_grid_weights(solver.xg, solver.yg)

    def image():
        jacobian = ours.jacobian(sigma) / np.abs(v0)[:, None]
        noise = (jacobian**2).sum(axis=1) ** (0.5 * p)
        return weights.T @ eit.Operator(jacobian, eit.Prior.identity(), np.sqrt(lamb), noise=noise)((v1 - v0) / np.abs(v0))

    # Equal except for the sign of its Jacobian.
    assert min(np.linalg.norm(s * image() - expected) for s in (1.0, -1.0)) < 1e-6 * np.linalg.norm(expected)

    def theirs():
        solver.setup(p=p, lamb=lamb, perm=1, jac_normalized=True)
        return solver.solve(v1, v0, normalize=True)

    ratio = seconds(theirs) / seconds(image)
    with capsys.disabled():
        print(f"\nGREIT, {len(mesh.element)} elements: pyEIT takes {ratio:.0f} times as long")
