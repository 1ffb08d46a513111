"""The boundary under arbitrary arrays: a result or an exception of dermis, never anything else."""

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hn

import dermis
from dermis import eit

# The same arrays in every run of the tests on a clean clone; others in a run by hand.
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
