"""Arbitrary arguments: every call returns a result or raises an exception of dermis, nothing else."""

import os
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hn

import dermis
from dermis import eit, mit

# The same arrays in every test run on a clean clone, but random ones when run by hand.
PATIENT = settings(
    deadline=None, max_examples=60, suppress_health_check=list(HealthCheck), derandomize="CI" in os.environ, database=None
)
ARRAYS = st.one_of(
    hn.arrays(hn.scalar_dtypes(), hn.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5)),
    hn.arrays(np.float64, st.sampled_from([(208,), (2, 208), (0, 208), (208, 1)])),
    st.floats(),
    st.text(),
    st.none(),
    st.lists(st.one_of(st.floats(), st.integers(), st.none()), max_size=4),
)


@pytest.fixture(scope="module")
def pipe(skin):
    return dermis.Pipeline(skin)


@PATIENT
@given(frame=ARRAYS)
def test_frames(pipe, frame):
    try:
        assert pipe.process(frame).image.ndim == 2
    except dermis.Error as error:
        assert "expected" in str(error)


@PATIENT
@given(sigma=ARRAYS, cotangent=ARRAYS)
def test_models(disc, sigma, cotangent):
    for call in (
        lambda: disc.voltages(sigma),
        lambda: disc.jacobian(sigma),
        lambda: disc.voltages_many(sigma),
        lambda: disc.vjp(disc.sigma, cotangent),
        lambda: disc.image(sigma, cotangent),
        lambda: disc.grid.to_pixels(sigma),
    ):
        try:
            assert isinstance(call(), np.ndarray)
        except dermis.Error:
            pass


@PATIENT
@given(nodes=ARRAYS, elements=ARRAYS)
def test_meshes(nodes, elements):
    try:
        eit.Mesh(nodes, elements)
    except dermis.Error:
        pass


@PATIENT
@given(
    nodes=hn.arrays(np.float64, hn.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=8)),
    elements=hn.arrays(np.int64, hn.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=4), elements=st.integers(-1, 8)),
)
def test_small_meshes(nodes, elements):
    try:
        mesh = eit.Mesh(nodes, elements)
        eit.ForwardModel(mesh, eit.points(range(4)), eit.Protocol.adjacent(4)).voltages(np.ones(len(mesh.elements)))
    except dermis.Error:
        pass


@PATIENT
@given(
    stimulations=hn.arrays(np.float64, hn.array_shapes(min_dims=2, max_dims=2, max_side=4)),
    measurements=hn.arrays(np.float64, hn.array_shapes(min_dims=2, max_dims=2, max_side=4)),
    of=hn.arrays(np.int64, hn.array_shapes(max_dims=1, max_side=4), elements=st.integers(-2, 5)),
)
def test_protocols(stimulations, measurements, of):
    try:
        eit.Protocol(stimulations, measurements, of)
    except dermis.Error:
        pass


@PATIENT
@given(text=st.text(max_size=200))
def test_skin_files(text):
    try:
        dermis.Skin(text + "\n")
    except dermis.Error:
        pass


@PATIENT
@given(jacobian=ARRAYS, rule=st.one_of(st.floats(), st.text(), st.tuples(st.text(), st.floats())))
def test_operators(jacobian, rule):
    try:
        operator = eit.Operator(jacobian, eit.Prior.identity(), rule)
        assert operator.hyperparameter > 0
    except dermis.Error:
        pass


# Types that people confuse, in addition to valid ones.
NUMBERS = st.one_of(st.floats(), st.integers(-(2**70), 2**70), st.none(), st.text(max_size=5), st.booleans())
# Python's own exceptions for arguments of the wrong type.
PYTHON_ERRORS = (TypeError, OverflowError)


def attempt(*calls, also=()):
    """Checks that every call returns, or raises an allowed exception."""
    for call in calls:
        try:
            call()
        except (dermis.Error, *also):
            pass


@PATIENT
@given(baselines=ARRAYS, frames=ARRAYS, positions=ARRAYS, loads=ARRAYS)
def test_calibrations(model, baselines, frames, positions, loads):
    rest = model.voltages()
    two, places = np.stack([1.01 * rest, 0.99 * rest]), [[0.01, 0.0], [-0.01, 0.0]]
    attempt(
        lambda: dermis.calibrate(model, baselines, frames, positions),
        lambda: dermis.calibrate(model, rest, frames, positions),
        lambda: dermis.calibrate(model, rest, two, positions),
        lambda: dermis.calibrate(model, baselines, two, places),
        lambda: dermis.calibrate(model, rest, two, places, forces_n=loads),
        lambda: dermis.calibrate(model, rest, two, places, depths_m=loads),
        also=PYTHON_ERRORS,
    )


@PATIENT
@given(numbers=st.dictionaries(st.sampled_from(["amplitude", "snr_db", "noise_v", "places"]), NUMBERS))
def test_designs(disc, numbers):
    places = numbers.get("places")
    if isinstance(places, int) and 16 < places <= 128:
        numbers["places"] = 16
    attempt(lambda: dermis.design(disc, **numbers), also=PYTHON_ERRORS)


@pytest.fixture(scope="module")
def session():
    with dermis.open("twin:ionic-disc") as session:
        yield session


@PATIENT
@given(numbers=st.lists(NUMBERS, max_size=4), named=st.dictionaries(st.sampled_from(["pressure_kpa", "pointer", "force_n"]), NUMBERS))
def test_sessions(session, numbers, named):
    attempt(
        lambda: session.press(*numbers, **named),
        lambda: session.release(*numbers[:1]),
        lambda: session.set_hyperparameter(*numbers[:1]),
        lambda: session.tare(force=bool(numbers)),
        also=PYTHON_ERRORS,
    )
    assert next(session).image.ndim == 2


@PATIENT
@given(source=st.text(max_size=40), named=st.dictionaries(st.sampled_from(["skin", "frames", "speed", "calibration", "forces", "as_set"]), NUMBERS))
def test_opening(source, named):
    # Exclude anything that could be somebody's instrument.
    for scheme in ("", "twin:", "file:"):
        if "tcp" in source or "serial" in source:
            return
        attempt(lambda: dermis.open(scheme + source, **named).close(), also=(*PYTHON_ERRORS, ValueError))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz") / "whole.mcap"
    record = ["record", "ionic-disc", "--speed", "0", "--frames", "40", "--out", str(path)]
    subprocess.run([sys.executable, "-m", "dermis", *record], check=True)
    return path


@PATIENT
@given(data=st.data())
def test_recordings(recorded, data):
    """Recordings with bytes changed, removed and inserted give frames or an exception."""
    whole = recorded.read_bytes()
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        change = data.draw(st.sampled_from(["flip", "cut", "put"]))
        if change == "flip":
            damaged[at] ^= data.draw(st.integers(1, 255))
        elif change == "cut":
            del damaged[at : at + data.draw(st.integers(1, 4096))]
        else:
            damaged[at:at] = data.draw(st.binary(min_size=1, max_size=64))
        if not damaged:
            break
    path = recorded.with_name("damaged.mcap")
    path.write_bytes(bytes(damaged))

    def read():
        recording = dermis.Recording(path)
        attempt(recording.frames, recording.times, recording.touches, recording.baselines, recording.events)
        attempt(lambda: [None for _ in dermis.open(str(path))])

    attempt(read)


@PATIENT
@given(start=NUMBERS, stop=NUMBERS)
def test_parts_of_recordings(recorded, start, stop):
    recording = dermis.Recording(recorded)
    try:
        frames = recording.frames(start, stop)
    except (dermis.Error, *PYTHON_ERRORS):
        return
    assert frames.shape == (len(range(40)[start:stop]), 208)


@PATIENT
@given(first=ARRAYS, second=ARRAYS, numbers=st.lists(NUMBERS, min_size=3, max_size=3))
def test_parts_of_models(first, second, numbers):
    mesh = eit.Mesh([[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]])
    model = eit.ForwardModel(mesh, eit.points(range(4)), eit.Protocol.generate(4, keep_driven=True))
    operator = eit.Operator(model.jacobian([1.0, 1.0]), eit.Prior.identity(), 1e-2)
    number = numbers[0]
    calls = [partial(call, first, number) for call in (eit.Electrode.edges, eit.Electrode.faces, eit.Electrode.elements)]
    calls += [partial(call, first) for call in (model.voltages, model.voltages_many, model.jacobian, operator, model.transfer_impedance)]
    calls += [partial(call, first, second) for call in (model.vjp, model.node_potentials, model.electrode_potentials)]
    calls += [
        lambda: eit.ForwardModel(mesh, [eit.Electrode.elements(first, 0.1), *eit.points([1, 2, 3])], eit.Protocol.adjacent(4)),
        lambda: eit.Electrode.point(number),
        lambda: eit.Protocol.generate(4, first, second),
        lambda: eit.Protocol.adjacent(number if not isinstance(number, int) else abs(number) % 70),
        lambda: eit.Operator(model.jacobian([1.0, 1.0]), eit.Prior.identity(), 1e-2, noise=first),
        lambda: eit.Operator(model.jacobian([1.0, 1.0]), eit.Prior.gaussian(number), 1e-2, mesh=mesh),
        lambda: eit.Operator(model.jacobian([1.0, 1.0]), eit.Prior.noser(number), 1e-2),
        lambda: operator.at(number),
        lambda: eit.greit_figures(first, mesh.grid(8), *numbers),
        lambda: mesh.grid(number if not isinstance(number, int) else abs(number) % 100).to_pixels(first),
    ]
    # A centre that isn't a pair of numbers is rejected by pyo3.
    attempt(*calls, also=(*PYTHON_ERRORS, ValueError))


@PATIENT
@given(places=ARRAYS, numbers=st.lists(NUMBERS, min_size=6, max_size=6), middle=ARRAYS)
def test_coils(places, numbers, middle):
    two = [[-0.02, 0.0], [0.02, 0.0]]
    turns = numbers[2] if not isinstance(numbers[2], int) else abs(numbers[2]) % 50
    coils = mit.Coils(two, inner_m=0.002, outer_m=0.03, turns=3)
    ball = mit.Body.sphere(5e-3, 5.8e7, 1e4)
    attempt(
        lambda: mit.Coils(places, inner_m=0.002, outer_m=0.03, turns=3).mutuals_h(),
        lambda: mit.Coils(two, inner_m=numbers[0], outer_m=numbers[1], turns=turns, inductance_h=numbers[3], shield_z_m=numbers[4]),
        lambda: coils.changes_h(mit.Body.sphere(*numbers[:3], relative_permeability=numbers[3]), (0.0, 0.0, 0.03)),
        lambda: coils.changes_h(ball, middle),
        also=(*PYTHON_ERRORS, ValueError),
    )


@PATIENT
@given(values=ARRAYS, number=NUMBERS, text=st.text(max_size=20))
def test_other_calls(skin, model, pipe, values, number, text):
    attempt(
        lambda: dermis.Frame(values, sequence=number, time_s=number),
        lambda: pipe.process(dermis.Frame(values)),
        lambda: pipe.process(model.voltages(), time_s=number),
        lambda: pipe.set_hyperparameter(number),
        lambda: dermis.Pipeline(model, hyperparameter=number),
        lambda: dermis.Pipeline(model, calibration=number),
        lambda: model.image(model.voltages(), model.voltages(), prior=text, hyperparameter=number),
        lambda: model.image(model.voltages(), model.voltages(), prior={text: number}, hyperparameter={text: number}),
        lambda: dermis.find_order(model, values),
        lambda: dermis.Twin(skin, seed=number),
        lambda: dermis.Skin(number),
        lambda: dermis.Network.load(text),
        lambda: dermis.Calibration.load(text),
        lambda: dermis.read_frames(text),
        also=(*PYTHON_ERRORS, ValueError),
    )
