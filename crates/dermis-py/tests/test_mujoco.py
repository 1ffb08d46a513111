"""Skins in MuJoCo: signs and frames against its own contacts, errors of position and force, and invalid input."""

import doctest

import numpy as np
import pytest

import dermis

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

import dermis.mujoco
from dermis.errors import FileError, InputError, SkinError
from dermis.mujoco import Patch, SkinSensor

PLATE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    {before}
    <body name="tray" pos="0 0 {z}" euler="{euler}">
      <geom name="plate" type="cylinder" size="0.1 0.01" mass="5"/>
      <geom name="post" type="sphere" size="0.005" pos="0 0 -0.05" mass="0.1"/>
    </body>
    {after}
  </worldbody>
</mujoco>
"""
TOP = (0.0, 0.0, 10.0)


def ball(x_mm, y_mm, mass_kg=0.05, radius_mm=20.0, name="ball"):
    place = f"{x_mm / 1e3} {y_mm / 1e3} {radius_mm / 1e3 + 0.0099}"
    return (
        f'<body name="{name}" pos="{place}"><freejoint/>'
        f'<geom type="sphere" size="{radius_mm / 1e3}" mass="{mass_kg}" friction="1 0.05 0.01"/></body>'
    )


def brick(x_mm, y_mm, mass_kg=0.1):
    place = f"{x_mm / 1e3} {y_mm / 1e3} 0.0199"
    return f'<body pos="{place}"><freejoint/><geom type="box" size="0.012 0.012 0.01" mass="{mass_kg}"/></body>'


def scene(before="", after="", z=0.0, euler="0 0 0"):
    model = mujoco.MjModel.from_xml_string(PLATE.format(before=before, after=after, z=z, euler=euler))
    return model, mujoco.MjData(model)


@pytest.fixture(scope="module")
def liquid():
    return dermis.Skin("ionic-disc").model()


def run(model, data, sensor, seconds):
    readings = []
    end = data.time + seconds
    while data.time < end:
        mujoco.mj_step(model, data)
        readings += sensor.update()
    return readings


def test_place_and_force_on_the_liquid_disc(liquid):
    """Against MuJoCo's contacts: balls and bricks of 0.4 to 1 N over 80 % of the disc."""
    random = np.random.default_rng(5)
    errors_mm, ratios = [], []
    for thing in (ball, brick):
        model, data = scene(after=thing(0, 0))
        sensor = SkinSensor(model, data, Patch("palm", liquid, geom="plate", xyz_mm=TOP), seed=1)
        for _ in range(12):
            angle, share = random.uniform(0, 2 * np.pi), 0.8 * np.sqrt(random.uniform())
            model.body_mass[2] = random.uniform(0.04, 0.1)
            mujoco.mj_setConst(model, data)
            mujoco.mj_resetData(model, data)
            data.qpos[:2] = 0.087 * share * np.array([np.cos(angle), np.sin(angle)])
            run(model, data, sensor, 1.0)
            touches, contacts = sensor.touches("palm"), sensor.reading("palm").contacts
            assert contacts.force_n.sum() == pytest.approx(9.81 * model.body_mass[2], rel=0.01)
            weights = contacts.force_n / contacts.force_n.sum()
            centre = np.array([contacts.x_mm @ weights, contacts.y_mm @ weights])
            assert len(touches) > 0
            forces = -touches.force_n[:, 2]
            found = forces @ touches.position_mm[:, :2] / forces.sum()
            errors_mm.append(float(np.hypot(*(found - centre))))
            ratios.append(float(forces.sum() / contacts.force_n.sum()))
    print("position", np.round(errors_mm, 1), "force ratio", np.round(ratios, 2))
    assert np.median(errors_mm) < 3.0
    assert np.median(np.abs(np.array(ratios) - 1.0)) < 0.10
    assert np.quantile(np.abs(np.array(ratios) - 1.0), 0.9) < 0.15


@pytest.mark.parametrize(("thing", "side"), [(ball, 1), (brick, 0)])
def test_the_force_acts_on_the_sensor_in_both_orders_of_the_geoms(liquid, thing, side):
    """MuJoCo sorts the geoms of a contact by type: spheres, cylinders, boxes."""
    model, data = scene(after=thing(20, -30, 0.08))
    sensor = SkinSensor(model, data, Patch("palm", liquid, geom="plate", xyz_mm=TOP))
    run(model, data, sensor, 1.0)
    assert data.contact.geom[0, side] == model.geom("plate").id
    contacts = sensor.contacts("palm")
    assert contacts.force_n.sum() == pytest.approx(0.785, rel=0.01)
    np.testing.assert_allclose([contacts.x_mm.mean(), contacts.y_mm.mean()], [20, -30], atol=0.5)
    touches = sensor.touches("palm")
    np.testing.assert_allclose(touches.position_mm, [[20, -30, 10]], atol=5)
    assert touches.force_n[0, 2] < -0.5 and np.abs(touches.force_n[0, :2]).max() < 1e-9


def test_a_tilted_tray_that_carries_its_patch_on_a_body(liquid):
    """Place and normal force in the frames of patch, mount and world."""
    model, data = scene(after=ball(0, 0, 0.1).replace("0.0299", "0.2299"), z=0.2, euler="0 10 0")
    # Turned about the body's z, so that x and y swap.
    patch = Patch("palm", liquid, body="tray", xyz_mm=TOP, rpy_deg=(0, 0, 90))
    sensor = SkinSensor(model, data, patch)
    run(model, data, sensor, 0.35)
    contacts = sensor.contacts("palm")
    assert len(contacts.index) == 1
    world_mm = 1e3 * data.contact.pos[0]
    rotation, origin_mm = sensor.pose("palm")
    local = (world_mm - origin_mm) @ rotation
    np.testing.assert_allclose([contacts.x_mm[0], contacts.y_mm[0]], local[:2], atol=1e-9)
    wrench = np.zeros(6)
    mujoco.mj_contactForce(model, data, 0, wrench)
    assert contacts.force_n[0] == pytest.approx(wrench[0])
    # The ball rolls down along the world's x, which is -y of the patch.
    assert local[1] < -3 and abs(local[0]) < 1
    touches = {frame: sensor.touches("palm", frame) for frame in ("patch", "mount", "world")}
    np.testing.assert_allclose(touches["world"].normal[0], [np.sin(np.pi / 18), 0, np.cos(np.pi / 18)], atol=1e-9)
    np.testing.assert_allclose(touches["mount"].normal[0], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(touches["patch"].position_mm @ rotation.T + origin_mm, touches["world"].position_mm)
    np.testing.assert_allclose(touches["mount"].position_mm[0, 2], 10, atol=1e-9)
    with pytest.raises(InputError, match="frame = 'root': expected 'patch', 'mount' or 'world'"):
        sensor.touches("palm", "root")


def test_several_balls_on_one_geom(liquid):
    model, data = scene(after=ball(35, 25, 0.08, name="a") + ball(-35, -25, 0.08, name="b"))
    sensor = SkinSensor(model, data, Patch("palm", liquid, geom="plate", xyz_mm=TOP))
    run(model, data, sensor, 1.0)
    touches = sensor.touches("palm")
    assert len(sensor.contacts("palm").index) == len(touches) == 2
    order = np.argsort(touches.position_mm[:, 0])
    np.testing.assert_allclose(touches.position_mm[order, :2], [[-35, -25], [35, 25]], atol=5)


def test_a_bent_skin_on_a_cylinder():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody>
        <geom name="forearm" type="cylinder" size="0.095 0.1" euler="90 0 0"/>
        <body pos="0.03 0.02 0.1101"><joint type="slide" axis="0 0 1"/><geom type="sphere" size="0.02" mass="0.4"/></body>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    # The geom's z is the world's -y; the patch's y runs along it, and its z up.
    patch = Patch("forearm", "piezo-cylinder", geom="forearm", xyz_mm=(0, 95, 0), rpy_deg=(-90, 0, 0))
    sensor = SkinSensor(model, data, patch)
    with pytest.raises(InputError, match="data: expected positions of geoms; call mujoco.mj_forward first"):
        sensor.pose("forearm")
    mujoco.mj_forward(model, data)
    rotation, _ = sensor.pose("forearm")
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-9)
    run(model, data, sensor, 0.5)
    contacts = sensor.contacts("forearm")
    angle = np.arcsin(0.03 / 0.115)
    assert contacts.x_mm[0] == pytest.approx(95 * angle, abs=0.2) and contacts.y_mm[0] == pytest.approx(20, abs=0.2)
    touches = sensor.touches("forearm")
    assert len(touches) == 1
    np.testing.assert_allclose(touches.position_mm[0], 1e3 * data.contact.pos[0], atol=4)
    np.testing.assert_allclose(touches.normal[0], [np.sin(angle), 0, np.cos(angle)], atol=0.05)


def test_patches_of_one_body_share_no_contact():
    model, data = scene(after=ball(0, 0, 0.2))
    top = Patch("top", "healing-square", body="tray", xyz_mm=TOP)
    below = Patch("below", "healing-square", body="tray", xyz_mm=(0, 0, 7), reach_mm=10)
    bottom = Patch("bottom", "healing-square", body="tray", xyz_mm=(0, 0, -10), rpy_deg=(180, 0, 0), reach_mm=30)
    sensor = SkinSensor(model, data, [below, top, bottom])
    run(model, data, sensor, 0.5)
    assert [len(sensor.contacts(name).index) for name in ("top", "below", "bottom")] == [1, 0, 0]


def test_frames_come_at_the_skins_own_rate(liquid):
    model, data = scene()
    sensor = SkinSensor(model, data, Patch("palm", liquid, geom="plate", xyz_mm=TOP))
    readings = run(model, data, sensor, 1.0)
    np.testing.assert_allclose([reading.time_s for reading in readings], np.arange(17) / 16)
    # A late caller gets all of them.
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert len(sensor.update()) == 16 and sensor.update() == []
    assert sensor.reading("palm").time_s == 2.0


def test_a_simulation_that_starts_again_rests_the_skin(liquid):
    model, data = scene(after=ball(0, 0, 0.1))
    sensor = SkinSensor(model, data, Patch("palm", liquid, geom="plate", xyz_mm=TOP))
    run(model, data, sensor, 1.0)
    assert len(sensor.touches("palm")) == 1
    mujoco.mj_resetData(model, data)
    data.qpos[:3] = [0, 0, 1]
    mujoco.mj_forward(model, data)
    (reading,) = sensor.update()
    assert reading.time_s == 0 and len(sensor.touches("palm")) == 0
    run(model, data, sensor, 0.3)
    assert len(sensor.touches("palm")) == 0


@pytest.mark.parametrize(
    ("patches", "words"),
    [
        ([Patch("a", "healing-square", geom="plat")], "patch 'a': geom = 'plat': expected a geom of the model .*'plate', 'post'"),
        ([Patch("a", "healing-square", body="arm")], "patch 'a': body = 'arm': expected a body of the model .*'tray'"),
        ([Patch("a", "healing-square", geom=17)], "patch 'a': geom = 17: expected 0 to 1"),
        ([Patch("a", "healing-square", geom=1.5)], "geom = 1.5: expected the name or number of a geom"),
        ([Patch("a", "healing-square", body=0)], "body = 0: expected a body with geoms"),
        ([Patch("a", "healing-square")], "patch 'a': expected geom or body, got neither"),
        ([Patch("a", "healing-square", geom="plate", body="tray")], "expected geom or body, got both"),
        ([Patch("a", "healing-square", geom="plate")] * 2, "name = 'a': expected a different name"),
        (
            [Patch("a", "healing-square", geom="plate"), Patch("b", "healing-square", geom=0)],
            "patch 'b': geom = 0 already has patch 'a'",
        ),
        ([Patch("", "healing-square", geom="plate")], "name = '': expected a name"),
        ([Patch("a", "healing-square", geom="plate", xyz_mm=(0, 0))], r"patch 'a': xyz_mm = \(0, 0\): expected three"),
        ([Patch("a", "healing-square", geom="plate", rpy_deg=(0, np.nan, 0))], "patch 'a': rpy_deg = .*nan"),
        ([Patch("a", "healing-square", geom="plate", radius_mm=-1)], "patch 'a': radius_mm = -1: expected millimetres"),
        ([Patch("a", "healing-square", geom="plate", reach_mm=0)], "patch 'a': reach_mm = 0"),
        ([], "patches: expected at least one"),
        (["plate"], r"patches\[0\]: expected a dermis.mujoco.Patch, got str"),
    ],
)
def test_what_is_wrong_with_patches_is_named(patches, words):
    model, data = scene()
    with pytest.raises(InputError, match=words):
        SkinSensor(model, data, patches)


def test_other_mistakes_are_named(liquid):
    model, data = scene()
    with pytest.raises(SkinError, match="patch 'a': .*nothing"):
        SkinSensor(model, data, Patch("a", "nothing", geom="plate"))
    with pytest.raises(FileError, match="patch 'a': none.json: cannot read"):
        SkinSensor(model, data, Patch("a", "ionic-disc", geom="plate", calibration="none.json"))
    with pytest.raises(InputError, match="model: expected a mujoco.MjModel, got str"):
        SkinSensor("arm.xml", data, Patch("a", liquid, geom="plate"))
    with pytest.raises(InputError, match="seed = -1"):
        SkinSensor(model, data, Patch("a", liquid, geom="plate"), seed=-1)
    sensor = SkinSensor(model, data, Patch("a", liquid, geom="plate"))
    with pytest.raises(InputError, match="patch 'a': no frame yet"):
        sensor.reading("a")
    with pytest.raises(InputError, match="patch = 'b': expected one of 'a'"):
        sensor.touches("b")


def test_a_simulation_that_has_diverged_is_named(liquid):
    model, data = scene(after=ball(0, 0, 0.1))
    sensor = SkinSensor(model, data, Patch("palm", liquid, geom="plate", xyz_mm=TOP))
    mujoco.mj_step(model, data)
    data.efc_force[:] = np.nan
    with pytest.raises(InputError, match=r"patch 'palm': MuJoCo's contacts: forces_n\[0\]\[\d\] = nan: expected finite"):
        sensor.update()


def test_examples_of_the_docstrings_run():
    assert doctest.testmod(dermis.mujoco).failed == 0
