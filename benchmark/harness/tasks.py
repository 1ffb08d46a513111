"""The tasks: information for the methods, questions, and the files of predictions.

A case is a training set with its test set. Predictions are written to METHOD/TASK/SET/PART.csv, where `score.py` reads
them, whichever program wrote them.
"""

import math
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from . import data as sets
from . import splits

MM = 1000.0
# Number of frames answered one at a time to measure the speed.
TIMED = 20
RUNS = {
    "session": ["line2"],
    "damaged": ["cut1", "cut2", "cut3", "doublecut1", "doublecut2"],
    "healed": ["heal1", "heal2", "doubleheal1", "doubleheal2"],
}
# The watch: number of frames at rest given to the method, and ranges of frames with events (from 0, both ends included).
# In an event, the difference between consecutive frames exceeds three times the median difference.
REST = 64
EVENTS = [(490, 505), (663, 665)]
LEVELS = range(1, 8)


class RuleError(RuntimeError):
    """A method breaks a rule of the benchmark."""


@dataclass
class Case:
    """A training set with its test set, and its description for the tables."""

    task: str
    set: str
    size: str
    part: str
    kind: str
    told: SimpleNamespace = None
    frames: np.ndarray = None
    rows: np.ndarray = None
    truth: np.ndarray = None
    unit: str = "mm"
    is_frozen: bool = True
    rest: np.ndarray = None  # Frames just before each judged press, if published.
    extra: dict = field(default_factory=dict)

    @property
    def path(self):
        return Path(self.task) / self.set.replace("/", "-") / f"{self.part}.csv"


def told(kind, frames, targets, **more):
    """Information for a method in a task with labels."""
    return SimpleNamespace(kind=kind, frames=frames, targets=targets, session=np.zeros(len(frames), int), **more)


def outline(name):
    """Known outline of a skin: the diameter of the gel disc, or else a guessed square."""
    return {"skin": "hydrogel-disc", "outline_mm": "171"} if name == "hydrogel" else {"skin": None, "outline_mm": "100x100"}


def place(data, depth=False):
    """Place of single presses after 10, 50, 400 and 1,500 pokes of a skin, or their depth after 400."""
    for name in sets.skins(data):
        frames, positions = sets.skin(Path(data) / name)
        parts, is_frozen = splits.read_or_make("place", name, len(frames), lambda: splits.place(name, len(frames)))
        if depth and positions[:, 2].std() < 0.3e-3:
            continue  # All depths are nearly the same.
        targets = positions[:, 2:] if depth else positions[:, :2]
        rest = sets.hydrogel(Path(data) / name)[0] if name == "hydrogel" else None
        for part, rows in parts.items():
            if part == "test" or (depth and not part.startswith("400.")):
                continue
            yield Case(
                "depth" if depth else "place", name, part.split(".")[0], part, "depth" if depth else "place",
                told("depth" if depth else "place", frames[rows], targets[rows], places=positions[rows, :2], **outline(name),
                     rest=None if rest is None else rest[rows]),
                frames[parts["test"]], parts["test"], targets[parts["test"]] * MM, is_frozen=is_frozen,
                rest=None if rest is None else rest[parts["test"]],
            )  # fmt: skip


def depth(data):
    return place(data, depth=True)


def pairs(data, task):
    """A skin in two sessions, or before and after damage, with no, few or many new pokes."""
    for old, new, kind in splits.PAIRS:
        first, second = sets.skin(Path(data) / old), sets.skin(Path(data) / new)
        if kind != task or not first or not second:
            continue
        name, sizes = f"{old}_{new}", (len(first[0]), len(second[0]))
        parts, is_frozen = splits.read_or_make(task, name, sizes[1], lambda: splits.pair(old, new, *sizes))
        pokes, test = parts.pop("old"), parts.pop("test")
        for part, rows in [("0.1", np.array([], int)), *parts.items()]:
            for strategy in ("unchanged",) if not len(rows) else ("alone", "pooled"):
                kept = pokes if strategy != "alone" else pokes[:0]
                case = told(
                    "place", np.concatenate([first[0][kept], second[0][rows]]),
                    np.concatenate([first[1][kept, :2], second[1][rows, :2]]), **outline(new),
                )  # fmt: skip
                case.session = np.repeat([0, 1], [len(kept), len(rows)])
                yield Case(
                    task, name, part.split(".")[0], f"{part}@{strategy}", "place", case, second[0][test], test,
                    second[1][test, :2] * MM, is_frozen=is_frozen, extra={"strategy": strategy},
                )  # fmt: skip


def lines(data, task):
    """Fifteen presses along a line on a gel membrane for training; the same line later, after cuts, and healed, for testing."""
    folder = Path(data) / "hydrogel-damage"
    if not (folder / "line1.csv").is_file():
        return
    runs = {run: sets.table(folder / f"{run}.csv") for run in ["line1", *RUNS.get(task, [])]}
    pressed = {run: frames[0::2] - frames[1::2] for run, frames in runs.items()}
    numbers = np.arange(15.0)[:, None]
    for run in RUNS.get(task, []):
        case = told("place", pressed["line1"], numbers, skin=None, outline_mm=None)
        yield Case(task, "hydrogel-damage", "15", run, "line", case, pressed[run], np.arange(15), numbers, "presses")


def session(data):
    yield from pairs(data, "session")
    yield from lines(data, "session")


def damaged(data):
    yield from pairs(data, "damaged")
    yield from lines(data, "damaged")
    yield from lines(data, "healed")


def several(data):
    """Patterns of one to six touches, learnt from singles, from all patterns of another batch, or within a batch."""
    first, second = sets.six_points(data, 1), sets.six_points(data, 2)
    if not first or not second:
        return
    parts, is_frozen = splits.read_or_make(
        "several", "six-points", max(len(first[1]), len(second[1])), lambda: splits.six_points(first[1], second[1])
    )
    for part, source, test in (("singles", first, "test"), ("all", first, "test"), ("within", second, "within-test")):
        rows, judged = parts[part], parts[test]
        quiet = parts["untouched"]
        yield Case(
            "several", "six-points", str(len(rows)), part, "points",
            told("points", source[0][rows], source[1][rows].astype(float), skin=None, outline_mm=None),
            np.concatenate([second[0][judged], second[2][quiet + 1] - second[2][quiet]]), judged,
            np.concatenate([second[1][judged], np.zeros((len(quiet), 6), int)]), "points", is_frozen,
        )  # fmt: skip


def unlabelled(data):
    """The gel disc without labels. Methods get outline, electrodes, protocol and untouched frames."""
    folder = Path(data) / "hydrogel"
    if not (folder / "ohmc16_pressed.csv").is_file():
        return
    rest, pressed, positions = sets.hydrogel(folder)
    board = sets.board(data)
    angles = 2 * np.pi * np.arange(16) / 16 + np.radians(22.5)
    identity = np.eye(16)
    case = SimpleNamespace(
        radius_m=0.0855, electrodes_m=0.0855 * np.column_stack([np.sin(angles), -np.cos(angles)]), rest=rest, skin="hydrogel-disc",
        drives=identity[board[:, 0]] - identity[board[:, 1]], reads=identity[board[:, 2]] - identity[board[:, 3]],
    )  # fmt: skip
    every = np.arange(len(pressed))
    yield Case("unlabelled", "hydrogel", "0", "all", "unlabelled", case, pressed, every, positions[:, :2] * MM, rest=rest)


def segmentation(data):
    """The training phantoms of the Kuopio Tomography Challenge 2023 at its seven levels."""
    folder = Path(data) / "ktc"
    if not (folder / "voltages.csv").is_file():
        return
    volts = sets.table(folder / "voltages.csv", 5, head=1).T
    currents = sets.table(folder / "injection_32x76.csv", 76)
    truth = np.array([sets.table(folder / f"truth_train{k}.csv", 256) for k in range(1, 5)]).astype(np.uint8)
    angles = np.pi / 2 + 2 * np.pi * np.arange(32) / 32
    electrodes = np.column_stack([np.cos(angles), np.sin(angles)])
    reads = np.tile(np.eye(32)[:31] - np.eye(32)[1:], (76, 1))
    drives = np.repeat(currents.T, 31, axis=0)
    for level in LEVELS:
        lost = np.arange(2 * (level - 1))
        kept = ~((drives[:, lost] != 0).any(1) | (reads[:, lost] != 0).any(1))
        case = SimpleNamespace(
            electrodes=electrodes, drives=drives[kept], reads=reads[kept], reference=volts[0, kept], radius_m=0.115,
            kept=kept, level=level, skin="ktc-tank",
        )  # fmt: skip
        yield Case("segmentation", "ktc", str(level), f"level{level}", "labels", case, volts[1:][:, kept], np.arange(4), truth, "score")


def watch(data):
    """One long watch of a gel skin that drifts and is disturbed. Methods raise alarms."""
    path = Path(data) / "hydrogel-damage" / "monitored.csv"
    if not path.is_file():
        return
    frames = sets.table(path)
    case = SimpleNamespace(frames=frames[:REST], period_s=8.0, skin="hydrogel-disc", folder=path.parent)
    yield Case("watch", "hydrogel-damage", str(REST), "alarms", "alarms", case, frames[REST:], np.arange(REST, len(frames)), None, "frames")


TASKS = {
    "place": place, "session": session, "damaged": damaged, "several": several, "unlabelled": unlabelled,
    "depth": depth, "segmentation": segmentation, "watch": watch,
}  # fmt: skip
NEEDS = {
    "place": "cam09, five-skins or hydrogel", "session": "hydrogel-damage", "damaged": "five-skins and cam09, or hydrogel-damage",
    "several": "six-points", "unlabelled": "hydrogel", "depth": "hydrogel, cam09/03 or cam09/05", "segmentation": "ktc",
    "watch": "hydrogel-damage",
}  # fmt: skip


def cases(data, only=TASKS):
    """All cases of the given tasks, with extra ones (`@own`) for methods that use which pokes are old."""
    for task in only:
        for case in TASKS[task](data):
            yield case
            if case.extra.get("strategy") == "pooled":
                yield replace(case, part=case.part.replace("@pooled", "@own"), extra={"strategy": "own"})


def write_rows(path, head, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    cells = [",".join(f"{value:.5g}" if isinstance(value, float) else str(value) for value in row) for row in rows]
    path.write_text("\n".join([head, *cells]) + "\n", encoding="utf-8")


COLUMNS = {
    "place": ("x_mm", "y_mm"),
    "unlabelled": ("x_mm", "y_mm"),
    "line": ("press",),
    "depth": ("depth_mm",),
}


def is_timed(case):
    """True if the tables use the case's times: places after the first draw of each number of pokes."""
    return case.task == "place" and case.part.endswith(".1")


def predict(method, case, folder):
    """Runs one method on one case and writes its predictions. Returns times, or None if the method skips the task.

    An answer that has a function `rate` measures its own speed, in frames per second.
    """
    entry = {"labels": "segment", "unlabelled": "unlabelled", "alarms": "watch"}.get(case.kind, "regress")
    function = getattr(method, entry)
    if function is None:
        return None
    begun = time.perf_counter()
    answer = function(case.told)
    trained = time.perf_counter() - begun
    if answer is None:
        return None
    path, begun = folder / case.path, time.perf_counter()
    if case.kind == "alarms":
        alarms = [int(row) for row, frame in zip(case.rows, case.frames) if answer(frame)]
        write_rows(path, "frame", [[row] for row in alarms])
        return trained, len(case.rows) / (time.perf_counter() - begun)
    if case.kind == "labels":
        labels = np.asarray(answer(case.frames), np.uint8)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path.with_suffix(".npz"), labels=labels)
        return trained, len(labels) / (time.perf_counter() - begun)
    more = (case.rest,) if case.rest is not None and getattr(answer, "wants_rest", case.kind == "unlabelled") else ()
    found, sigma, *extra = answer(case.frames, *more)
    if np.shape(found) != (expected := (len(case.frames), case.truth.shape[1])) or np.shape(sigma) != expected:
        raise RuleError(f"an answer of shapes {np.shape(found)} and {np.shape(sigma)}, expected {expected} twice")
    if case.kind == "points":
        rows = [[int(frame), int(point) + 1] for frame, point in np.argwhere(np.asarray(found) > 0.5)]
        write_rows(path, "frame,point", rows)
    else:
        scale = 1.0 if case.kind == "line" else MM
        names = COLUMNS[case.kind]
        table = np.hstack([np.asarray(found, float), np.asarray(sigma, float)]) * scale
        rows = [[int(row), *map(float, values)] for row, values in zip(case.rows, table) if np.isfinite(values[: len(names)]).all()]
        # Superfluous touches have no place to judge: write them as rows of nan.
        for row, count in zip(case.rows, extra[0] if extra else []):
            rows += [[int(row), *[float("nan")] * table.shape[1]]] * int(count)
        write_rows(path, ",".join(["frame", *names, *(f"sigma_{name}" for name in names)]), rows)
    if hasattr(answer, "rate"):
        return trained, answer.rate(case.frames, *more) if is_timed(case) else math.nan
    if getattr(answer, "calls_per_s", None) is not None:
        return trained, answer.calls_per_s
    times = []
    for index in range(min(TIMED, len(case.frames))):
        one = (case.frames[index : index + 1], *(rest[index : index + 1] for rest in more))
        begun = time.perf_counter()
        alone = answer(*one)[0]
        times.append(time.perf_counter() - begun)
        if not np.allclose(np.asarray(alone, float)[0], np.asarray(found, float)[index], rtol=1e-3, atol=1e-6, equal_nan=True):
            raise RuleError(f"frame {case.rows[index]} is answered differently alone and among others: answers may not depend on other frames")
    return trained, 1 / float(np.median(times))
