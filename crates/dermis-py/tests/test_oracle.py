"""EIDORS' values (computed with EIDORS 3.10 in Octave), compared as in the Rust tests: Python loses nothing."""

import json

import numpy as np
import pytest
from conftest import reference

from dermis import eit

CASES = ("tiny_disc8", "disc16_si", "square16", "square16_internal_lines", "tank3d16")


def relative(got, expected):
    return np.linalg.norm(np.asarray(got) - expected) / np.linalg.norm(expected)


@pytest.fixture(scope="module", params=CASES)
def case(request):
    folder = reference("eit", request.param)
    case = json.loads((folder / "case.json").read_text())
    mesh = eit.Mesh(case["nodes"], case["elems"])
    electrodes = []
    for electrode in case["electrodes"]:
        if electrode["type"] == "PEM":
            electrodes.append(eit.Electrode.point(electrode["node"]))
            continue
        faces = np.asarray(electrode["faces"])
        make = eit.Electrode.edges if faces.shape[1] == 2 else eit.Electrode.faces
        electrodes.append(make(faces, electrode["z_contact"]))
    protocol = eit.Protocol(case["stim"], case["meas"], case["meas_stim"])
    return folder, case, eit.ForwardModel(mesh, electrodes, protocol)


# Tolerances: the differences between EIDORS and an independent dense implementation (4e-13 and 5e-13), with room for
# the order of sums.
@pytest.mark.parametrize("which", ["hom", "incl", "wave"])
def test_voltages(case, which):
    _, values, model = case
    assert relative(model.voltages(values[f"sigma_{which}"]), values[f"v_{which}"]) < 1e-10
    many = model.voltages_many([values[f"sigma_{which}"]] * 3, threads=2)
    assert relative(many[2], values[f"v_{which}"]) < 1e-10


@pytest.mark.parametrize("which", ["hom", "wave"])
def test_jacobians(case, which):
    zstandard = pytest.importorskip("zstandard", reason="zstandard is not installed")
    folder, values, model = case
    stored = (folder / f"J_{which}.f64.planes.zst").read_bytes()
    planes = zstandard.ZstdDecompressor().decompressobj().decompress(stored)
    # Eight planes of bytes, with the most significant bytes of all numbers first.
    rows = len(values["meas"])
    expected = np.frombuffer(planes, "u1").reshape(8, -1).T.copy().view(">f8").reshape(rows, -1).astype(float)
    assert relative(model.jacobian(values[f"sigma_{which}"]), expected) < 1e-9
    cotangent = np.random.default_rng(1).normal(size=rows)
    assert relative(model.vjp(values[f"sigma_{which}"], cotangent), expected.T @ cotangent) < 1e-9


def test_images(case):
    _, values, model = case
    jacobian = model.jacobian(values["sigma_hom"])
    v0, v1 = np.asarray(values["v_hom"]), np.asarray(values["v_incl"])
    priors = {"laplace": eit.Prior.laplace(), "noser": eit.Prior.noser(0.5), "tikhonov": eit.Prior.identity()}
    compared = 0
    for recon in values["recon"]:
        name = next((name for name in priors if name in recon["prior"].lower()), None)
        # The Laplace prior is singular; model space solves it exactly if there are few unknowns.
        if name is None or recon["normalize_measurements"] or (name == "laplace" and jacobian.shape[1] > 1024):
            continue
        operator = eit.Operator(jacobian, priors[name], recon["hyperparameter"], mesh=model.mesh)
        assert relative(operator(v1 - v0), recon["x"]) < 1e-6, recon["prior"]
        compared += 1
    assert compared > 0
