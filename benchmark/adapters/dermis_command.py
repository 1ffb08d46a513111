"""Runs dermis through its command: `dermis calibrate`, `reconstruct`, `segment`. The variable DERMIS names the program.

Where `TOLD` says so, dermis gets more information than the plain methods: the skin's outline, or the skin file that ships.
"""

import csv
import json
import math
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

PROGRAM = os.environ.get("DERMIS") or shutil.which("dermis")
# Time limit for one call of the command, in seconds.
LIMIT_S = 600
# Number of pokes from which speed is measured (that takes a few seconds), and number of frames to measure it on.
TIMED_POKES, TIMED_FRAMES = 400, 4000
HANDLES_SESSIONS = True
TOLD = (
    "a guessed outline (a square of 100 mm), and for the gel disc the skin file that ships and the frame before each press. For "
    "the six points it gets a guessed hexagon"
)


def missing():
    """Returns the reason why the method can't run here, or None if it can."""
    return None if PROGRAM else "the command dermis is not found (install it, or let the variable DERMIS name it)"


def call(*arguments, folder=None):
    """Runs the command. Raises RuntimeError with the end of its output if it fails."""
    done = subprocess.run([PROGRAM, *map(str, arguments)], cwd=folder, capture_output=True, text=True, timeout=LIMIT_S)
    if done.returncode:
        raise RuntimeError(f"dermis {arguments[0]}: status {done.returncode}: {' '.join(done.stderr.split())[-300:]}")
    return done


def write(path, values, head=None):
    np.savetxt(path, values, delimiter=",", fmt="%.9g", header=head or "", comments="")


def touches(path, count):
    """The first touch of each frame by amplitude, with its sigma and depth, and the number of further touches."""
    rows = {}
    with open(path, encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            rows.setdefault(int(row["frame"]), []).append(row)
    names = ("x_mm", "y_mm", "sigma_x_mm", "sigma_y_mm", "depth_mm", "sigma_depth_mm", "depth_sigma_mm")
    found, extra = {name: np.full(count, np.nan) for name in names}, np.zeros(count, int)
    for frame, several in rows.items():
        best = max(several, key=lambda row: abs(float(row["amplitude"])))
        extra[frame] = len(several) - 1
        for name in names:
            if best.get(name):
                found[name][frame] = float(best[name])
    return found, extra


class Skin:
    """A calibrated skin in its own folder. Answers frames with `dermis reconstruct`."""

    def __init__(self, told, kind):
        self.kind, self.folder = kind, tempfile.TemporaryDirectory()
        self.path = Path(self.folder.name)
        self.skin, self.rest, start = told.skin or "skin.toml", getattr(told, "rest", None), []
        self.wants_rest = self.rest is not None
        self.untouched = ["--differences"] if self.rest is None else ["--baseline", "rest.csv"]
        old = told.session == 0 if told.session.any() else np.zeros(len(told.frames), bool)
        if old.any():
            self.calibrate(told, old, "old.json", [])
            start = ["--start", "old.json"]
        self.calibrate(told, ~old, "calibration.json", start)
        self.pokes = len(told.frames)

    def calibrate(self, told, rows, name, more):
        places = told.targets if self.kind == "place" else np.hstack([told.places, told.targets])
        write(self.path / "frames.csv", told.frames[rows] + (0 if self.rest is None else self.rest[rows]))
        if self.rest is not None:
            write(self.path / "rest.csv", self.rest[rows])
        write(self.path / "positions.csv", places[rows], "x_m,y_m" if self.kind == "place" else "x_m,y_m,depth_m")
        if told.skin:
            skin = [told.skin]
        elif (self.path / "skin.toml").exists():
            skin = ["skin.toml"]
        else:
            skin = ["--outline-mm", told.outline_mm, "--channels", told.frames.shape[1], "--write-skin", "skin.toml"]
        done = call(
            "calibrate", *skin, *self.untouched, "--frames", "frames.csv", "--positions", "positions.csv", "--out", name, *more,
            folder=self.path,
        )  # fmt: skip
        self.reads_depth = "depth or force of the pokes: not estimated" not in done.stdout

    def reconstruct(self, frames, rest):
        write(self.path / "judged.csv", frames + (0 if self.rest is None else rest))
        if self.rest is not None:
            write(self.path / "rest.csv", rest)
        begun = time.perf_counter()
        call(
            "reconstruct", self.skin, *self.untouched, "--calibration", "calibration.json", "--frames", "judged.csv",
            "--touches", "touches.csv", folder=self.path,
        )  # fmt: skip
        return time.perf_counter() - begun

    def rate(self, frames, rest=None):
        """Frames per second without the start of the program: many frames against two. NaN if the start hides them, or
        after few pokes."""
        if self.pokes < TIMED_POKES:
            return math.nan
        rows = np.resize(np.arange(len(frames)), TIMED_FRAMES)
        several = [(frames[part], None if rest is None else rest[part]) for part in (rows[:2], rows)]
        short, whole = (min(self.reconstruct(*both) for _ in range(2)) for both in several)
        return (TIMED_FRAMES - 2) / (whole - short) if whole > 2 * short else math.nan

    def __call__(self, frames, rest=None):
        self.reconstruct(frames, rest)
        found, extra = touches(self.path / "touches.csv", len(frames))
        if self.kind == "depth":
            sigma = np.where(np.isfinite(found["sigma_depth_mm"]), found["sigma_depth_mm"], found["depth_sigma_mm"])
            return found["depth_mm"][:, None] / 1e3, sigma[:, None] / 1e3, extra
        values = np.column_stack([found["x_mm"], found["y_mm"]])
        return values / 1e3, np.column_stack([found["sigma_x_mm"], found["sigma_y_mm"]]) / 1e3, extra


# The positions of the six points are unpublished: assume a hexagon on a disc with this diameter.
DISC_MM = 100.0
HEXAGON_M = 0.03 * np.column_stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)])


def points(told):
    """The touched points. Assigns every detected touch to the nearest point."""
    touched = told.targets.sum(1) > 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        rows = [(number, *HEXAGON_M[point]) for number, pattern in enumerate(told.targets[touched]) for point in np.flatnonzero(pattern)]
        write(path / "frames.csv", told.frames[touched])
        write(path / "positions.csv", np.array(rows), "group,x_m,y_m")
        call(
            "calibrate", "--outline-mm", f"{DISC_MM:.0f}", "--channels", told.frames.shape[1], "--write-skin", "skin.toml",
            "--differences", "--frames", "frames.csv", "--positions", "positions.csv", "--out", "calibration.json", folder=path,
        )  # fmt: skip
        skin, calibration = ((path / name).read_bytes() for name in ("skin.toml", "calibration.json"))

    def answer(frames):
        found = np.zeros((len(frames), 6))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder)
            (path / "skin.toml").write_bytes(skin)
            (path / "calibration.json").write_bytes(calibration)
            write(path / "judged.csv", frames)
            call(
                "reconstruct", "skin.toml", "--differences", "--calibration", "calibration.json", "--frames", "judged.csv",
                "--touches", "touches.csv", folder=path,
            )  # fmt: skip
            with open(path / "touches.csv", encoding="utf-8", newline="") as file:
                for row in csv.DictReader(file):
                    place = np.array([float(row["x_mm"]), float(row["y_mm"])]) / 1e3
                    found[int(row["frame"]), np.linalg.norm(HEXAGON_M - place, axis=1).argmin()] = 1
        return found, np.full(found.shape, 0.5)

    answer.calls_per_s = math.nan
    return answer


def regress(told):
    if told.kind == "points":
        return points(told)
    if told.kind not in ("place", "depth") or told.targets.shape[1] == (1 if told.kind == "place" else 2):
        return None  # Presses along a line have no known place.
    skin = Skin(told, told.kind)
    # dermis reports when the frames don't grow with depth, and then estimates none.
    return skin if told.kind == "place" or skin.reads_depth else None


def unlabelled(told):
    """The gel disc from its skin file: electrodes, protocol and the board's circuit."""

    def answer(frames, rest):
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder) / "frames.csv", frames)
            write(Path(folder) / "rest.csv", rest)
            begun = time.perf_counter()
            call("reconstruct", told.skin, "--baseline", "rest.csv", "--frames", "frames.csv", "--touches", "t.csv", folder=folder)
            answer.calls_per_s = len(frames) / (time.perf_counter() - begun)
            found, extra = touches(Path(folder) / "t.csv", len(frames))
        sigma = np.column_stack([found["sigma_x_mm"], found["sigma_y_mm"]]) / 1e3
        return np.column_stack([found["x_mm"], found["y_mm"]]) / 1e3, sigma, extra

    return answer


def segment(told):
    """The tank from its skin file, with the network that ships. Channels of lost electrodes are empty cells."""

    def answer(frames):
        columns = np.full((len(told.kept), 1 + len(frames)), np.nan)
        columns[told.kept] = np.column_stack([told.reference, frames.T])
        with tempfile.TemporaryDirectory() as folder:
            for name, rows in (("rest", columns[:, :1].T), ("frames", columns[:, 1:].T)):
                lines = [",".join("" if np.isnan(value) else f"{value:.9g}" for value in row) for row in rows]
                (Path(folder) / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
            call("segment", told.skin, "--baseline", "rest.csv", "--frames", "frames.csv", "--out", "labels.npy", folder=folder)
            return np.load(Path(folder) / "labels.npy")

    return answer


def watch(told):
    """The frame where `dermis evidence` reports damage, from the live pipeline with `watch = true`, frame by frame.

    The watch settings in the skin file were chosen with this recording. A disturbance is not damage if the levels return.
    """
    done = call("evidence", "--data", told.folder.parent, "--only", told.folder.name, "--json")
    figures = {figure["name"]: figure["value"] for figure in json.loads(done.stdout)["sets"][0]["findings"][0]["here"]}
    if figures["damage sites reported"] > 1:
        raise RuntimeError(f"dermis evidence reports {figures['damage sites reported']:.0f} damage sites, but only the frame of the first")
    at = int(figures["first in frame"]) - len(told.frames) if figures["damage sites reported"] else -1
    count = iter(range(1 << 62))
    return lambda frame: next(count) == at
