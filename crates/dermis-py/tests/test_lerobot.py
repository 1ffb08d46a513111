"""Windows of touch for camera images, compared with a plain loop over slots, and invalid input."""

import numpy as np
import pytest

from dermis import lerobot
from dermis.errors import InputError


def by_hand(readings, time_s, at_s, slots, rate_hz):
    """The definition, slot by slot."""
    result = np.full((len(at_s), slots, readings.shape[1]), np.nan)
    for n, at in enumerate(at_s):
        for s in range(slots):
            begin, end = at - (slots - s) / rate_hz, at - (slots - s - 1) / rate_hz
            inside = np.flatnonzero((begin < time_s) & (time_s <= end))
            if len(inside):
                result[n, s] = readings[inside[-1]]
    return result


def test_a_jittering_clock_with_lost_frames_gives_what_the_definition_says(random):
    time_s = np.sort(np.arange(600) / 150 + random.normal(0, 5e-4, 600))
    kept = np.sort(random.permutation(600)[:580])
    time_s, readings = time_s[kept], random.normal(size=(580, 8))
    camera_s = np.arange(0.05, 3.9, 1 / 30) + random.normal(0, 1e-3, 116)
    found = lerobot.windows(readings, time_s, camera_s, slots=5, rate_hz=150.0)
    expected = by_hand(readings, time_s, camera_s, 5, 150.0)
    assert found.shape == (116, 5, 8)
    np.testing.assert_array_equal(found, expected)
    assert np.isnan(found).any(), "lost frames are missing and not made up"


def test_no_window_looks_into_the_future_and_none_repeats_a_frame():
    time_s = np.arange(100) / 100
    found = lerobot.windows(time_s[:, None], time_s, [0.305, 0.5], slots=4, rate_hz=100)
    np.testing.assert_allclose(found[0, :, 0], [0.27, 0.28, 0.29, 0.30])
    # A frame on the edge belongs to the slot that ends there, despite rounding.
    np.testing.assert_allclose(found[1, :, 0], [0.47, 0.48, 0.49, 0.50])
    early = lerobot.windows(time_s[:, None], time_s, [-1.0], slots=4, rate_hz=100)
    assert np.isnan(early).all()


def test_copies_of_a_frame_are_left_out():
    readings, time_s = np.array([[1.0], [2.0], [9.0]]), [0.00, 0.01, 0.02]
    found = lerobot.windows(readings, time_s, [0.02], slots=3, rate_hz=100, sequence=[4, 5, 5])
    np.testing.assert_array_equal(found[0, :, 0], [1.0, 2.0, np.nan])


def test_images_and_empty_lists_have_windows_too():
    images = np.arange(24.0).reshape(4, 2, 3)
    found = lerobot.windows(images, [0, 1, 2, 3], [3.0], slots=2, rate_hz=1.0)
    np.testing.assert_array_equal(found[0], images[2:])
    assert lerobot.windows(np.zeros((0, 3)), [], [1.0], slots=2, rate_hz=1.0).shape == (1, 2, 3)
    assert lerobot.windows(images, [0, 1, 2, 3], [], slots=2, rate_hz=1.0).shape == (0, 2, 2, 3)


def test_point_sets_keep_the_strongest_and_pad_the_rest():
    touches = [[0, 0, 0, 0, 0, -1], [1, 0, 0, 0, 0, -3], [2, 0, 0, np.nan, np.nan, np.nan]]
    np.testing.assert_array_equal(lerobot.points(touches, 2)[:, 0], [1, 0])
    padded = lerobot.points(touches, 4)
    np.testing.assert_array_equal(padded[:3, 0], [1, 0, 2])
    assert np.isnan(padded[3]).all() and np.isnan(lerobot.points([], 2)).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time_s": [0, 2, 1]}, r"time_s\[2\] = 1\.0 after 2\.0"),
        ({"time_s": [0, np.nan, 1]}, r"time_s\[1\] = nan: expected finite"),
        ({"at_s": [np.inf]}, r"at_s\[0\] = inf"),
        ({"time_s": [0, 1]}, r"readings of shape \(3, 1\) with 2 times"),
        ({"readings": [1, 2, 3]}, "frames x channels"),
        ({"slots": 0}, "slots = 0: expected a whole number above 0"),
        ({"slots": 2.0}, "slots = 2.0"),
        ({"rate_hz": 0}, "rate_hz = 0: expected a number above 0"),
        ({"rate_hz": np.nan}, "rate_hz = nan"),
        ({"sequence": [1, 2]}, "expected one number per frame"),
        ({"slots": 10**12}, "GiB: expected at most 8"),
    ],
)
def test_what_is_wrong_is_named(change, words):
    good = {"readings": np.ones((3, 1)), "time_s": [0, 1, 2], "at_s": [2.0], "slots": 2, "rate_hz": 1.0}
    with pytest.raises(InputError, match=words):
        lerobot.windows(**{**good, **change})


def test_point_sets_of_other_shapes_are_refused():
    for shape in [(2, 3), (1, 3), (2, 2, 6)]:
        with pytest.raises(InputError, match="expected n x 6"):
            lerobot.points(np.ones(shape), 4)
    with pytest.raises(InputError, match="most = 0"):
        lerobot.points(np.ones((2, 6)), 0)
