"""Presses a twin, and the pipeline locates the press. Needs nothing but this package."""

import dermis

skin = dermis.Skin("healing-square")
twin = dermis.Twin(skin, seed=1)
pipe = dermis.Pipeline(skin)
for _ in range(40):
    pipe.process(twin.step())
twin.press(x_mm=10, y_mm=-5, radius_mm=8, force_n=20.0)
result = pipe.process(twin.step())
for _ in range(20):
    result = pipe.process(twin.step())
for touch in result.touches:
    print(f"touch {touch.id} ({touch.phase}) at {touch.x_mm:.1f}, {touch.y_mm:.1f} mm")
print("all electrodes are sound:", result.health["sound"])
