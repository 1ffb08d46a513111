"""A ball rolls over the liquid skin in MuJoCo; the skin follows it. Draws rolling_ball.png.

Needs MuJoCo (pip install "dermis[mujoco]"), and matplotlib for the picture.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

import dermis
from dermis.mujoco import Patch, SkinSensor

SCENE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="plate" type="cylinder" size="0.1 0.01" pos="0 0 -0.01"/>
    <body name="ball" pos="-0.065 -0.03 0.0199"><freejoint/>
      <geom type="sphere" size="0.02" mass="0.06"/>
    </body>
  </worldbody>
</mujoco>
"""
SECONDS = 2.0


def roll() -> tuple[dermis.Skin, list[list[float]], Any]:
    """Rolls the ball; returns for each frame the time, and position and force of the ball and of the touch."""
    mujoco = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    # 6 cm/s to the right and 3 cm/s up, without slipping.
    data.qvel[:] = [0.06, 0.03, 0.0, -1.5, 3.0, 0.0]
    # The plate's top is 10 mm above the middle of its geom.
    sensor = SkinSensor(model, data, Patch("plate", "ionic-disc", geom="plate", xyz_mm=(0, 0, 10)), seed=1)
    rows: list[list[float]] = []
    image: Any = None
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
        for reading in sensor.update():
            touches, contacts = sensor.touches("plate"), reading.contacts
            if len(touches) == 1 and len(contacts.index) == 1:
                x_mm, y_mm, _ = touches.position_mm[0]
                sigma_mm = float(np.sqrt(np.trace(touches.covariance_mm2[0]) / 2))
                ball = [float(contacts.x_mm[0]), float(contacts.y_mm[0]), float(contacts.force_n[0])]
                rows.append([reading.time_s, *ball, float(x_mm), float(y_mm), -float(touches.force_n[0, 2]), sigma_mm])
                image = reading.result
    return sensor.skin("plate"), rows, image


def draw(skin: dermis.Skin, rows: list[list[float]], last: Any, path: str) -> None:
    """Draws the path of ball and touches over the last image, and the force over time."""
    matplotlib = import_module("matplotlib")
    matplotlib.use("agg")
    plt = import_module("matplotlib.pyplot")
    figure, (above, beside) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    time_s, ball_x, ball_y, ball_n, x_mm, y_mm, force_n, sigma_mm = np.array(rows).T
    shown = above.imshow(last.image, extent=last.extent_mm, cmap="RdBu_r", vmin=-0.15, vmax=0.15)
    figure.colorbar(shown, ax=above, label=last.image_quantity)
    rim = 1e3 * np.vstack([skin.outline, skin.outline[:1]])
    above.plot(*rim.T, color="0.3", lw=1)
    above.plot(ball_x, ball_y, color="tab:green", lw=2, label="ball (MuJoCo)")
    above.errorbar(x_mm, y_mm, xerr=sigma_mm, yerr=sigma_mm, fmt="k.", lw=0.8, label="touches, 1 sigma")
    above.set(xlabel="x (mm)", ylabel="y (mm)", title="A ball rolls over the liquid skin", aspect="equal")
    above.legend(loc="lower right")
    beside.plot(time_s, ball_n, color="tab:green", lw=2, label="contact force (MuJoCo)")
    beside.plot(time_s, force_n, "k.", label="force by the skin")
    beside.set(xlabel="time (s)", ylabel="force (N)", ylim=(0, 1.5 * ball_n.max()), title="Net force")
    beside.legend(loc="lower right")
    figure.savefig(path, dpi=120)


if find_spec("mujoco") is None:
    print("MuJoCo is not installed")
else:
    skin, rows, last = roll()
    table = np.array(rows)
    errors_mm = np.hypot(table[:, 4] - table[:, 1], table[:, 5] - table[:, 2])
    ratios = table[:, 6] / table[:, 3]
    print(f"{len(rows)} frames with one touch; position error: median {np.median(errors_mm):.1f} mm")
    print(f"force by the skin / force of the ball: median {np.median(ratios):.2f}")
    if find_spec("matplotlib") is not None:
        draw(skin, rows, last, "rolling_ball.png")
        print("drew rolling_ball.png")
