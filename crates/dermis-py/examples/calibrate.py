"""A calibration by pokes at known places, and its benefit; the twin stands in for a skin on the bench."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import dermis

skin = dermis.Skin("ionic-disc")
twin = dermis.Twin(skin, seed=3)
places_mm = [(x, y) for x in (-8.0, 0.0, 8.0) for y in (-8.0, 0.0, 8.0)]


def settled() -> NDArray[np.float64]:
    """The last of several frames, once the skin has come to rest."""
    return [twin.step().values for _ in range(20)][-1]


baselines: list[NDArray[np.float64]] = []
frames: list[NDArray[np.float64]] = []
for x, y in places_mm:
    twin.release()
    baselines.append(settled())
    twin.press(x, y)
    frames.append(settled())
cal = dermis.calibrate(skin, np.stack(baselines), np.stack(frames), 1e-3 * np.array(places_mm))
print(f"left out, a poke is {cal.leave_one_out_mm:.2f} mm off (median)")
with TemporaryDirectory() as folder:
    path = Path(folder) / "calibration.json"
    cal.save(path)
    pipe = dermis.Pipeline(skin, calibration=path)
print(pipe.skin.name, "is calibrated by", cal.pokes, "pokes")
