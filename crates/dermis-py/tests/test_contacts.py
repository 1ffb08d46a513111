"""Contacts of a simulator become frames and touches; invalid ones are refused with a reason. Needs no simulator."""

import doctest

import numpy as np
import pytest

import dermis
from dermis import contacts
from dermis.contacts import SimulatedSkin, carried, contacts_to_frame, spatial
from dermis.errors import InputError


@pytest.fixture(scope="module")
def flat():
    return dermis.Skin("healing-square")


@pytest.fixture(scope="module")
def bent():
    return dermis.Skin("piezo-cylinder")


@pytest.fixture(scope="module")
def ring():
    """A square with a hole."""
    return dermis.Skin(
        """name = "ring"
modality = "eit"
[frontend]
shape = { polygon = { outer_mm = [[-50, -50], [50, -50], [50, 50], [-50, 50]], holes_mm = [[[-20, -20], [20, -20], [20, 20], [-20, 20]]] } }
layer = { kind = "sheet", thickness_mm = 5.0, conductivity_s_per_m = 0.2, gauge_factor = 1.0, modulus_kpa = 60.0 }
electrodes = { rim = { count = 16, width_mm = 5.0 } }
contact_impedance_ohm_m2 = 1e-3
[backend]
instrument = "any"
current_ma = 1.0
drive = "adjacent"
measure = "adjacent"
"""
    )


def test_a_contact_is_a_press_of_the_twin(flat):
    one, other = dermis.Twin(flat, seed=3, fade_s=0), dermis.Twin(flat, seed=3, fade_s=0)
    contacts_to_frame(one, [], [])
    other.step()
    frame = contacts_to_frame(one, [[10, -5, 0], [-20, 20, -0.4]], [[3, -2, -20], [0, 0, -8]], radius_mm=6)
    other.press(10, -5, radius_mm=6, force_n=20, pointer=0)
    other.press(-20, 20, radius_mm=6, force_n=8, pointer=1)
    np.testing.assert_array_equal(frame.values, other.step().values)
    # The next frame's contacts replace them.
    other.release()
    np.testing.assert_array_equal(contacts_to_frame(one, [], []).values, other.step().values)
    assert one.truth == []


def test_without_a_fade_the_whole_load_acts_in_the_next_frame(flat):
    sudden, fading = dermis.Twin(flat, seed=1, fade_s=0), dermis.Twin(flat, seed=1)
    for twin in (sudden, fading):
        twin.step()
        twin.press(0, 0, radius_mm=8, force_n=10)
        twin.step(1e-3)
    assert [press["force_n"] for press in sudden.truth] == pytest.approx([10])
    sudden.step()
    fading.step(1e-3)
    assert fading.truth[0]["force_n"] < 8
    with pytest.raises(InputError, match="fade_s: expected 0 to 60 seconds, got -1"):
        dermis.Twin(flat, fade_s=-1)


def test_only_what_pushes_on_the_skin_presses(flat, ring):
    places = [[10, -5, 0], [10, -5, 0], [70, 0, 0], [0, 0, 9], [0, 0, -9], [0, 0, 0]]
    forces = [[0, 0, -2], [0, 0, 2], [0, 0, -2], [0, 0, -2], [0, 0, -2], [5, 5, 0]]
    assert carried(flat, places, forces).index.tolist() == [0]
    assert carried(flat, places, forces, reach_mm=10).index.tolist() == [0, 3, 4]
    # Not in a hole, but on its edge.
    assert carried(ring, [[0, 0], [20, 0], [35, 35]], [1, 1, 1]).index.tolist() == [1, 2]


def test_on_a_bent_skin_lengths_run_along_the_surface(bent):
    radius = 1e3 * bent.cylinder_radius_m
    assert radius == pytest.approx(95)
    angle = 0.5
    place = [radius * np.sin(angle), 12.0, radius * (np.cos(angle) - 1)]
    normal = np.array([np.sin(angle), 0, np.cos(angle)])
    found = carried(bent, [place], [-3 * normal + [0, 7, 0]])
    assert (found.x_mm[0], found.y_mm[0]) == pytest.approx((radius * angle, 12))
    assert (found.force_n[0], found.height_mm[0]) == pytest.approx((3, 0))
    touch = np.zeros(2, dermis.touch_dtype)
    touch["phase"], touch["force_n"] = ["move", "end"], 3
    touch["x_mm"], touch["y_mm"], touch["sigma_x_mm"], touch["sigma_y_mm"] = radius * angle, 12, 2, 1
    back = spatial(bent, touch)
    np.testing.assert_allclose(back.position_mm, [place])
    np.testing.assert_allclose(back.normal, [normal])
    np.testing.assert_allclose(back.force_n, [-3 * normal])
    along = np.array([np.cos(angle), 0, -np.sin(angle)])
    np.testing.assert_allclose(back.covariance_mm2[0], 4 * np.outer(along, along) + np.diag([0, 1, 0]), atol=1e-12)
    turned = back.in_frame([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3])
    np.testing.assert_allclose(turned.position_mm[0], [1 - place[1], 2 + place[0], 3 + place[2]])
    np.testing.assert_allclose(turned.covariance_mm2[0][0, 0], 1, atol=1e-12)


def test_a_brick_too_light_to_feel_leaves_no_ghosts(flat):
    """Four corners of 0.98 N, as MuJoCo reports a brick of 400 g."""
    skin = SimulatedSkin(flat, seed=1, radius_mm=3)
    corners = [[3, -18, 0], [27, -18, 0], [27, -2, 0], [3, -2, 0]]
    for _ in range(30):
        reading = skin.step(corners, [[0, 0, -0.981]] * 4)
    assert reading.contacts.force_n.sum() == pytest.approx(3.924)
    for touch in reading.result.touches:
        assert 0 < touch["x_mm"] < 30 and -21 < touch["y_mm"] < 1


def test_several_contacts_at_once_are_all_found(flat):
    skin = SimulatedSkin(flat, name="chest", seed=1, radius_mm=8)
    for _ in range(30):
        reading = skin.step([[25, 20, 0], [-25, -20, 0]], [[0, 0, -20], [0, 0, -20]])
    touches = spatial(flat, reading.result.touches)
    assert len(touches) == 2 and reading.patch == "chest"
    order = np.argsort(touches.position_mm[:, 0])
    np.testing.assert_allclose(touches.position_mm[order], [[-25, -20, 0], [25, 20, 0]], atol=3)
    skin.reset()
    assert len(skin.step([], []).result.touches) == 0


def test_skins_of_one_model_share_it_and_differ_in_noise(flat):
    model = flat.model()
    frames = [SimulatedSkin(model, seed=seed).step([], []).frame.values for seed in (1, 1, 2)]
    np.testing.assert_array_equal(frames[0], frames[1])
    assert (frames[0] != frames[2]).any()


@pytest.mark.parametrize(
    ("places", "forces", "words"),
    [
        ([[0, 0, 0]], [[0, 0, np.nan]], r"forces_n\[0\]\[2\] = nan: expected finite"),
        ([[0, 0, 0], [0, np.inf, 0]], [1, 2], r"positions_mm\[1\]\[1\] = inf"),
        ([[0, 0, 0]], [np.nan], r"forces_n\[0\] = nan"),
        ([[0, 0, 0]], [1, 2], "forces_n: expected one for each of 1 positions, got 2"),
        ([[0, 0, 0, 0]], [1], r"positions_mm: expected shape \(n, 2\) or \(n, 3\), got shape \(1, 4\)"),
        ([[0, 0, 0]], [[1, 2]], r"forces_n: expected shape \(n, 3\) or \(n,\), got shape \(1, 2\)"),
        ("here", [1], "positions_mm: expected numbers of shape"),
        ([[0, 0, 0]], [None], r"forces_n\[0\] = nan"),
    ],
)
def test_what_is_wrong_is_named(flat, places, forces, words):
    twin = dermis.Twin(flat, fade_s=0)
    with pytest.raises(InputError, match=words):
        contacts_to_frame(twin, places, forces)


def test_numbers_out_of_range_are_named(flat):
    with pytest.raises(InputError, match="reach_mm = 0: expected millimetres above 0"):
        carried(flat, [[0, 0]], [1], reach_mm=0)
    with pytest.raises(InputError, match="radius_mm = nan"):
        contacts_to_frame(dermis.Twin(flat, fade_s=0), [[0, 0]], [1], radius_mm=np.nan)
    with pytest.raises(InputError, match="no larger than the skin's"):
        SimulatedSkin(flat, radius_mm=1e3)
    with pytest.raises(dermis.SkinError, match="no-such"):
        SimulatedSkin("no-such")


def test_a_skin_says_which_points_lie_on_it(flat, ring):
    assert flat.contains([[0, 0], [0.05, 0.05], [0.0501, 0]]).tolist() == [True, True, False]
    assert ring.contains([[0, 0], [0.03, 0]]).tolist() == [False, True]
    assert flat.cylinder_radius_m is None
    with pytest.raises(InputError, match="points_m"):
        flat.contains([[0, 0, 0]])


def test_examples_of_the_docstrings_run():
    assert doctest.testmod(contacts) == (0, doctest.testmod(contacts).attempted)
