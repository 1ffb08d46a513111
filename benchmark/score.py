#!/usr/bin/env python3
"""Scores predictions and prints the tables. Only needs NumPy.

    score.py --data DATA PREDICTIONS             every method in a folder of predictions (PREDICTIONS/METHOD/TASK/SET/PART.csv)
    score.py --truth TRUTH.csv PREDICTION.csv    one file against one: both with the column frame, then x_mm, y_mm (or depth_mm)

A row of predictions is a touch: frame, place, and sigma per axis in the same unit. A frame without a row is a frame without
a detected touch. If a frame has several rows, the first one counts, and the others are superfluous touches.
"""

import argparse
import csv
import functools
import math
import sys
from pathlib import Path

try:
    import numpy as np
except ImportError:
    sys.exit("score.py needs NumPy: pip install numpy")

MM = 1000.0


class ScoreError(ValueError):
    """Predictions can't be read; the message names file and line."""


def read_touches(path, names):
    """Touches by frame: lists of (values, sigmas). Sigmas are None if the file has no such columns."""
    path = Path(path)
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    sigmas = [f"sigma_{name}" for name in names]
    head = rows[0] if rows else []
    if head[: 1 + len(names)] != ["frame", *names] or head[1 + len(names) :] not in ([], sigmas):
        raise ScoreError(f"{path}:1: columns {','.join(head)}, expected {','.join(['frame', *names, *sigmas])}")
    touches = {}
    for line, row in enumerate(rows[1:], 2):
        try:
            frame, cells = int(row[0]), [float(cell) for cell in row[1:]]
        except (ValueError, IndexError):
            raise ScoreError(f"{path}:{line}: {','.join(row)!r}, expected a frame number and numbers") from None
        if len(cells) != len(head) - 1:
            raise ScoreError(f"{path}:{line}: {len(row)} cells, expected {len(head)}")
        values, spread = np.array(cells[: len(names)]), np.array(cells[len(names) :])
        if spread.size and np.isfinite(values).all() and not (np.isfinite(spread) & (spread > 0)).all():
            raise ScoreError(f"{path}:{line}: sigma {row[-len(names) :]}, expected numbers above 0")
        touches.setdefault(frame, []).append((values, spread if spread.size else None))
    return touches


def quantile(errors, share):
    """Linear quantile of errors; some of them may be infinite."""
    ordered = np.sort(errors)
    place = share * (len(ordered) - 1)
    low, high = ordered[math.floor(place)], ordered[math.ceil(place)]
    return float(high if np.isinf(high) and place % 1 else low + (high - low) * (place % 1) if np.isfinite(high) else low)


def score_values(truth, frames, touches):
    """Scores single touches, one per frame.

    Errors are distances. The shares inside count each axis separately. A miss has an infinite error, and the negative log
    likelihood of a uniform guess over the bounding box of the truth. Likelihoods are Gaussian with independent axes, in natural
    logarithms and in the truth's unit.
    """
    truth = np.asarray(truth, float)
    unknown = sorted(set(touches) - {int(frame) for frame in frames})
    if unknown:
        raise ScoreError(f"frame {unknown[0]} is not in the test set")
    evenly = float(np.log(np.maximum(truth.max(0) - truth.min(0), 1e-9)).sum())
    errors, ratios, likelihoods, misses, extra, bare = [], [], [], 0, 0, False
    for frame, expected in zip(frames, truth):
        found = touches.get(int(frame), [])
        extra += max(len(found) - 1, 0)
        if not found or not np.isfinite(found[0][0]).all():
            misses += 1
            errors.append(np.inf)
            likelihoods.append(evenly)
            continue
        values, sigma = found[0]
        errors.append(float(np.linalg.norm(values - expected)))
        if sigma is None:
            bare = True
            continue
        ratio = (values - expected) / sigma
        ratios.append(np.abs(ratio))
        likelihoods.append(float((0.5 * ratio**2 + np.log(sigma) + 0.5 * np.log(2 * np.pi)).sum()))
    errors, ratios = np.array(errors), np.array(ratios)
    known = not bare and len(ratios) > 0
    finite = errors[np.isfinite(errors)]
    return {
        "frames": len(errors),
        "median": quantile(errors, 0.5),
        "p90": quantile(errors, 0.9),
        "rms": float(np.sqrt((finite**2).mean())) if len(finite) else math.inf,
        "inside_1": float((ratios <= 1).mean()) if known else math.nan,
        "inside_2.5": float((ratios <= 2.5).mean()) if known else math.nan,
        "nll": float(np.mean(likelihoods)) if known else math.nan,
        "misses": misses,
        "false": extra,
    }


def read_points(path, count, points=6):
    """Patterns (count x points) from a file of frame,point: one row per touch, points from 1."""
    found = np.zeros((count, points), int)
    for line, text in enumerate(Path(path).read_text(encoding="utf-8").splitlines(), 1):
        if line == 1:
            if text != "frame,point":
                raise ScoreError(f"{path}:1: columns {text}, expected frame,point")
            continue
        frame, _, point = text.partition(",")
        if not (frame.isdigit() and point.isdigit() and int(frame) < count and 1 <= int(point) <= points):
            raise ScoreError(f"{path}:{line}: {text!r}, expected a frame below {count} and a point from 1 to {points}")
        found[int(frame), int(point) - 1] = 1
    return found


def score_points(truth, found):
    """Scores patterns of several touches. Frames without a true touch are the untouched ones."""
    touched = truth.sum(1) > 0
    right = (truth == found).all(1)
    doubles = truth.sum(1) == 2
    return {
        "frames": int(touched.sum()),
        "patterns": float(right[touched].mean()),
        "doubles": float(right[doubles].mean()) if doubles.any() else math.nan,
        "points": float((truth == found)[touched].mean()),
        "count": float((truth.sum(1) == found.sum(1))[touched].mean()),
        "misses": int(((truth == 1) & (found == 0)).sum()),
        "false": int(((truth == 0) & (found == 1))[touched].sum()),
        "quiet_false": int(found[~touched].sum()),
    }


@functools.cache
def window(size, sigma=80.0, reach=160):
    """Gaussian weights between the pixels of a line, cut off at `reach` and normalised by their sum inside the image."""
    away = np.subtract.outer(np.arange(size), np.arange(size)).astype(float)
    weights = np.where(np.abs(away) <= reach, np.exp(-(away**2) / (2 * sigma**2)), 0)
    return weights / weights.sum(1, keepdims=True)


def blur(image):
    return window(len(image)) @ image @ window(len(image)).T


def similarity(truth, found, c1=1e-4, c2=9e-4):
    """Structural similarity of two masks, averaged over all pixels, as in the Kuopio Tomography Challenge 2023."""
    truth, found = truth.astype(float), found.astype(float)
    mean_t, mean_f = blur(truth), blur(found)
    var_t, var_f = blur(truth**2) - mean_t**2, blur(found**2) - mean_f**2
    covariance = blur(truth * found) - mean_t * mean_f
    map_ = (2 * mean_t * mean_f + c1) * (2 * covariance + c2) / ((mean_t**2 + mean_f**2 + c1) * (var_t + var_f + c2))
    return float(map_.mean())


def score_labels(truth, found):
    """The challenge's score of a label image, at best 1: mean similarity of the resistive and the conductive mask."""
    return 0.5 * (similarity(truth == 1, found == 1) + similarity(truth == 2, found == 2))


def score_alarms(alarms, first, last, events, grace=30):
    """False alarms outside the events (ranges of frames), and the delay of each event's detection in frames, nan if missed.

    Alarms up to `grace` frames after an event belong to it. Frames after the last event are not judged.
    """
    alarms = np.unique(np.asarray(alarms, int))
    last = min(last, events[-1][1] + grace)
    judged = alarms[(alarms >= first) & (alarms <= last)]
    belongs = np.zeros(len(judged), bool)
    delays = []
    for begin, end in events:
        inside = (judged >= begin) & (judged <= end + grace)
        belongs |= inside
        delays.append(float(judged[inside][0] - begin) if inside.any() else math.nan)
    outside = judged[~belongs]
    return {"false": int((np.diff(outside) > 1).sum() + (len(outside) > 0)), "false_frames": len(outside), "delays": delays}


def score_case(case, path):
    """Scores of one case's predictions."""
    names = {"line": ("press",), "depth": ("depth_mm",)}.get(case.kind, ("x_mm", "y_mm"))
    if case.kind == "points":
        return score_points(case.truth, read_points(path, len(case.truth)))
    if case.kind == "labels":
        with np.load(path.with_suffix(".npz")) as archive:
            labels = archive["labels"]
        if labels.shape != case.truth.shape:
            raise ScoreError(f"{path.with_suffix('.npz')}: labels of shape {labels.shape}, expected {case.truth.shape}")
        scores = [score_labels(truth, found) for truth, found in zip(case.truth, labels)]
        return {"score": float(np.mean(scores)), "worst": float(np.min(scores)), "frames": len(scores)}
    if case.kind == "alarms":
        from harness.tasks import EVENTS

        alarms = [int(text) for text in path.read_text(encoding="utf-8").splitlines()[1:] if text]
        return score_alarms(alarms, int(case.rows[0]), int(case.rows[-1]), EVENTS)
    try:
        return score_values(case.truth, case.rows, read_touches(path, names))
    except ScoreError as error:
        raise ScoreError(str(error) if str(path) in str(error) else f"{path}: {error}") from error


def score_all(cases, folder, methods=None, failures=None):
    """Scores all predictions in a folder. Returns dictionaries with method, task, set, size, part and the scores.

    Predictions that can't be scored raise ScoreError, or are added to the list `failures`.
    """
    found = []
    folder = Path(folder)
    names = methods or sorted(path.name for path in folder.iterdir() if path.is_dir())
    for case in cases:
        for method in names:
            path = folder / method / case.path
            if path.is_file() or path.with_suffix(".npz").is_file():
                row = {"method": method, "task": case.task, "set": case.set, "size": case.size, "part": case.part}
                row["strategy"] = case.extra.get("strategy", "")
                row["is_frozen"] = case.is_frozen
                try:
                    found.append(row | score_case(case, path))
                except ScoreError as error:
                    if failures is None:
                        raise
                    failures.append(str(error))
    return found


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("predictions", help="a folder of predictions; with --truth a file")
    parser.add_argument("--data", help="folder with the measured sets")
    parser.add_argument("--truth", help="a CSV file of true places")
    given = parser.parse_args(arguments)
    try:
        if given.truth:
            with open(given.truth, encoding="utf-8") as file:
                names = tuple(file.readline().strip().split(",")[1:])
            truth = read_touches(given.truth, names)
            values = np.array([touches[0][0] for touches in truth.values()])
            scores = score_values(values, list(truth), read_touches(given.predictions, names))
            print("  ".join(f"{key} {value:.4g}" for key, value in scores.items()))
            return 0
        if not given.data:
            parser.error("--data DATA or --truth TRUTH.csv is needed")
        from harness import report, tasks

        print(report.tables(score_all(tasks.cases(given.data), given.predictions), {}))
        return 0
    except (ScoreError, OSError, ValueError) as error:
        print(f"score.py: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
