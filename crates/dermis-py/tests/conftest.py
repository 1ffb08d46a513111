"""Shared fixtures. Skins are prepared once, since each takes a moment."""

from pathlib import Path

import numpy as np
import pytest

import dermis


@pytest.fixture(scope="session")
def skin():
    return dermis.Skin("healing-square")


@pytest.fixture(scope="session")
def model(skin):
    return skin.model()


@pytest.fixture(scope="session")
def disc():
    """A small model that is quick to differentiate by finite differences."""
    return dermis.Skin("hydrogel-disc").model(elements=400)


@pytest.fixture(scope="session")
def pressed(skin):
    """Frames of a twin: 40 at rest, then 40 pressed."""
    twin = dermis.Twin(skin, seed=1)
    rest = [twin.step() for _ in range(40)]
    twin.press(x_mm=10, y_mm=-5, radius_mm=8, force_n=20.0)
    return rest, [twin.step() for _ in range(40)]


@pytest.fixture
def random():
    return np.random.default_rng(7)


def reference(*parts):
    """A file or folder of the repository's reference values."""
    path = Path(__file__).resolve().parents[3].joinpath("tests", "data", "oracle", *parts)
    assert path.exists(), f"{path} is not there"
    return path
