"""A source of frames as a loop: here a twin that is pressed halfway. `session.show()` would open its live page."""

import dermis

with dermis.open("twin:ionic-disc", frames=120) as session:
    for number, result in enumerate(session):
        if number == 60:
            session.press(x_mm=5, y_mm=0)
        for touch in result.touches:
            if touch.phase == "begin":
                print(f"{result.time_s:.2f} s: touch {touch.id} at {touch.x_mm:.1f}, {touch.y_mm:.1f} mm")
    print(session.counters)
