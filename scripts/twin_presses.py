"""Skins as files, their outlines, and presses on their twins, for scripts/press-anywhere."""

import csv
import json
import math
import os
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parent.parent
# Random presses stay within this share of the outline.
INSIDE_SHARE = 0.85


def built_in_file(name):
    return ROOT / "crates" / "dermis-skin" / "skins" / f"{name}.toml"


def toml(value):
    """A value as TOML on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


def written(skin):
    return "".join(f"{json.dumps(key)} = {toml(value)}\n" for key, value in skin.items())


class Refused(Exception):
    pass


def dermis(*arguments):
    command = os.environ.get("DERMIS_BIN", ROOT / "target" / "release" / "dermis")
    run = subprocess.run([command, *map(str, arguments)], capture_output=True, text=True, timeout=1800)
    if run.returncode:
        raise Refused(f"dermis {' '.join(map(str, arguments[:2]))} ended with {run.returncode}: {run.stderr[-400:]}")
    return run.stdout


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def place(row):
    if "x_m" in row:
        return 1e3 * float(row["x_m"]), 1e3 * float(row["y_m"])
    return float(row["x_mm"]), float(row["y_mm"])


def seen(folder, skin, presses, repeats, seed, again=False):
    """Presses a twin and reads it; returns the true presses and the touches in each frame. `again` reads existing
    files."""
    name = folder / f"{seed}"
    baseline, frames, truth, touches = (f"{name}-{what}.csv" for what in ("rest", "frames", "truth", "touches"))
    sampled = ("--baseline", baseline, "--frames", frames)
    if not (again and pathlib.Path(truth).exists()):
        pressed = ("--presses", presses, "--repeats", repeats, "--seed", seed, "--truth", truth)
        dermis("twin", "sample", skin, *sampled, *pressed)
    dermis("reconstruct", skin, *sampled, "--touches", touches)
    found = {}
    for row in rows(touches):
        found.setdefault(int(row["frame"]), []).append(row)
    return rows(truth), found


class Outline:
    """The outline of a skin file, in millimetres about its centre."""

    def __init__(self, shape):
        (kind, sizes), *_ = shape.items()
        self.disc_mm = 0.5 * sizes["diameter_mm"] if kind == "disc" else None
        if kind == "polygon":
            self.rims = [sizes["outer_mm"], *sizes.get("holes_mm", [])]
        else:
            width, height = sizes.get("width_mm", 0.0), sizes.get("height_mm", 0.0)
            if kind != "rectangle":
                width = height = sizes.get("side_mm", sizes.get("diameter_mm"))
            x, y = 0.5 * width, 0.5 * height
            self.rims = [[(-x, -y), (x, -y), (x, y), (-x, y)]]
        self.low, self.high = ([pick(p[axis] for p in self.rims[0]) for axis in (0, 1)] for pick in (min, max))
        self.sides_mm = [high - low for low, high in zip(self.low, self.high)]

    def from_rim_mm(self, place):
        """Distance of a place from the rim; negative outside."""
        if self.disc_mm is not None:
            return self.disc_mm - math.hypot(*place)
        edges = [(a, b) for rim in self.rims for a, b in zip(rim, [*rim[1:], rim[0]])]
        inside = False
        for (x, y), (to_x, to_y) in edges:
            if (y > place[1]) != (to_y > place[1]) and place[0] < x + (place[1] - y) * (to_x - x) / (to_y - y):
                inside = not inside
        away = min(from_edge(place, a, b) for a, b in edges)
        return away if inside else -away

    def places(self, count, dice):
        """Random places, as far from the rim as in `dermis twin sample` (a share of the shorter side)."""
        margin = 0.5 * (1.0 - INSIDE_SHARE) * min(self.sides_mm)
        chosen = []
        while len(chosen) < count:
            place = [dice.uniform(low, high) for low, high in zip(self.low, self.high)]
            if self.from_rim_mm(place) >= margin:
                chosen.append(place)
        return chosen


def from_edge(place, a, b):
    along = [b[0] - a[0], b[1] - a[1]]
    away = [place[0] - a[0], place[1] - a[1]]
    share = (away[0] * along[0] + away[1] * along[1]) / max(along[0] ** 2 + along[1] ** 2, 1e-300)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(away[0] - share * along[0], away[1] - share * along[1])


def write_presses(path, groups):
    """A table of presses (x mm, y mm, radius mm, pressure kPa), with the presses of a group in consecutive rows."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["x_mm", "y_mm", "radius_mm", "pressure_kpa", "group"])
        for number, group in enumerate(groups):
            writer.writerows([*press, number] for press in group)


def usual_press(folder, skin):
    """Radius (mm) and pressure (kPa) of a skin's usual press."""
    truth = folder / "usual.csv"
    files = ("--baseline", folder / "usual-rest.csv", "--frames", folder / "usual-frames.csv", "--truth", truth)
    dermis("twin", "sample", skin, "--presses", "random:1", "--seed", 1, *files)
    row = rows(truth)[0]
    return 1e3 * float(row["radius_m"]), 1e-3 * float(row["pressure_pa"])
