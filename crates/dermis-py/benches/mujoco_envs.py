"""Steps per second of 16 MuJoCo environments with a skin each, on two processes.

A ball rolls over the skin in each; a step is 10 ms, and the skin makes frames at its own rate. Usage:

    python benches/mujoco_envs.py [SKIN ...]
"""

import multiprocessing
import sys
import time

import mujoco

import dermis
from dermis.mujoco import Patch, SkinSensor

ENVIRONMENTS, PROCESSES, STEPS = 16, 2, 300
SCENE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="plate" type="box" size="0.1 0.1 0.01" pos="0 0 -0.01"/>
    <body pos="-0.03 -0.02 0.0199"><freejoint/><geom type="sphere" size="0.02" mass="{mass}"/></body>
  </worldbody>
</mujoco>
"""


def mass_kg(skin: dermis.Skin) -> float:
    """Mass of the ball: a heavy one would press a liquid down to the bottom of its tray."""
    return 0.06 if 'kind = "liquid"' in skin.to_toml() else 1.0


def work(name: str, count: int, seed: int) -> tuple[int, int, float, float]:
    """Steps, frames, wall seconds and processor seconds of `count` environments in one process."""
    skin = dermis.Skin(name)
    model = mujoco.MjModel.from_xml_string(SCENE.format(mass=mass_kg(skin)))
    skin_model = skin.model()
    environments = []
    for number in range(count):
        data = mujoco.MjData(model)
        data.qvel[:] = [0.02, 0.01, 0.0, -0.5, 1.0, 0.0]
        sensor = SkinSensor(model, data, Patch("plate", skin_model, geom="plate", xyz_mm=(0, 0, 10)), seed=seed + number)
        environments.append((data, sensor))
    wall_s, processor_s, frames = time.perf_counter(), time.process_time(), 0
    for _ in range(STEPS):
        for data, sensor in environments:
            mujoco.mj_step(model, data, 5)
            frames += len(sensor.update())
    return STEPS * count, frames, time.perf_counter() - wall_s, time.process_time() - processor_s


if __name__ == "__main__":
    for name in sys.argv[1:] or ["ionic-disc", "healing-square", "hydrogel-disc", "piezo-disc"]:
        share = ENVIRONMENTS // PROCESSES
        with multiprocessing.get_context("spawn").Pool(PROCESSES) as pool:
            results = pool.starmap(work, [(name, share, 100 * number) for number in range(PROCESSES)])
        steps, frames = (sum(result[k] for result in results) for k in (0, 1))
        wall_s, processor_s = max(result[2] for result in results), sum(result[3] for result in results)
        print(
            f"{name}: {steps / wall_s:.0f} steps/s and {frames / wall_s:.0f} frames/s of {ENVIRONMENTS} environments; "
            f"{1e3 * processor_s / steps:.2f} ms of processor a step, {1e3 * processor_s / frames:.1f} a frame"
        )
