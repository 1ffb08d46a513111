"""Test and training rows for every task. The files in `splits/` are frozen; this module created them, and reads them.

    python3 -m harness.splits DATA      (in the folder benchmark) writes missing files, and changes none

A file has the columns `part` and `row`. Rows of the data file count from 0, without its header. Parts of `place/SET.csv`
are `test` and training rows `SIZE.DRAW`, such as `50.2`. No test row is in any training part.
"""

import sys
import zlib
from pathlib import Path

import numpy as np

from . import data as sets

SEED = 20261125
FOLDER = Path(__file__).resolve().parent.parent / "splits"
# Training sizes, with the number of draws for each: results from few pokes vary more, and take less time.
DRAWS = {10: 5, 50: 3, 400: 2, 1500: 1}
# Maximum number of test presses per skin. Small sets use a fifth of their presses.
TEST = 400
# Damaged skin: number of pokes from the old session; numbers of new pokes, with their draws.
OLD = 1000
NEW_DRAWS = {20: 5, 50: 3, 200: 2}
NEW_TEST = 500
# The same skin before and after damage, or in two sessions: data folders.
PAIRS = [("five-skins/circles", "cam09/16", "damaged"), ("cam09/04", "cam09/04-rep", "session")]


class SplitError(ValueError):
    """A split file has invalid content."""


def generator(name):
    """Random generator for one set. It depends only on the seed and the set's name."""
    return np.random.default_rng([SEED, zlib.crc32(name.encode())])


def place(name, rows):
    """Parts of a pressed skin with this many rows."""
    random = generator("place " + name)
    order = random.permutation(rows)
    test = min(TEST, rows // 5)
    parts, rest = {"test": np.sort(order[:test])}, order[test:]
    for size, draws in DRAWS.items():
        for draw in range(1, draws + 1):
            if size < len(rest) or (size == len(rest) and draw == 1):
                parts[f"{size}.{draw}"] = random.permutation(rest)[:size]
    return parts


def pair(old, new, old_rows, new_rows):
    """Parts for an old and a new session: `old` rows from the first; `test` and `SIZE.DRAW` from the second."""
    random = generator(f"pair {old} {new}")
    order = random.permutation(new_rows)
    test = min(NEW_TEST, new_rows // 2)
    parts, rest = {"old": random.permutation(old_rows)[:OLD], "test": np.sort(order[:test])}, order[test:]
    for size, draws in NEW_DRAWS.items():
        for draw in range(1, draws + 1):
            parts[f"{size}.{draw}"] = random.permutation(rest)[:size]
    return parts


def six_points(first, second):
    """Parts from the patterns of two batches: singles and all from the first, tests from the second."""
    random = generator("six-points")
    order = random.permutation(len(second))
    half = len(second) // 2
    return {
        "singles": np.flatnonzero(first.sum(1) == 1),
        "all": np.arange(len(first)),
        "test": np.arange(len(second)),
        "within": np.sort(order[:half]),
        "within-test": np.sort(order[half:]),
        "untouched": np.sort(random.permutation(len(second) - 1)[:100]),
    }


def file_of(task, name):
    return FOLDER / task / (name.replace("/", "-") + ".csv")


def read(task, name, rows):
    """Parts of a frozen split, or None. Raises SplitError for a row that isn't in the data."""
    path = file_of(task, name)
    if not path.is_file():
        return None
    parts = {}
    for line, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if line == 1 and text == "part,row":
            continue
        part, _, row = text.partition(",")
        if not part or not row.isdigit() or int(row) >= rows:
            raise SplitError(f"{path}:{line}: {text!r}, expected part,row with a row from 0 to {rows - 1}")
        parts.setdefault(part, []).append(int(row))
    return {part: np.array(found) for part, found in parts.items()}


def read_or_make(task, name, rows, make):
    """Parts, and whether they are frozen. A set without a file is split by the same rule."""
    found = read(task, name, rows)
    return (found, True) if found is not None else (make(), False)


def write(task, name, parts):
    """Writes a split file unless it exists."""
    path = file_of(task, name)
    if path.exists():
        return print(f"{path}: frozen, left as it is")
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"{part},{row}" for part, rows in parts.items() for row in rows]
    path.write_text("\n".join(["part,row", *lines]) + "\n", encoding="utf-8")
    print(f"{path}: written")


def main(folder):
    folder = Path(folder)
    for name in sets.skins(folder):
        write("place", name, place(name, len(sets.skin(folder / name)[0])))
    for old, new, task in PAIRS:
        first, second = sets.skin(folder / old), sets.skin(folder / new)
        if first and second:
            write(task, f"{old}_{new}", pair(old, new, len(first[0]), len(second[0])))
    first, second = sets.six_points(folder, 1), sets.six_points(folder, 2)
    if first and second:
        write("several", "six-points", six_points(first[1], second[1]))


if __name__ == "__main__":
    main(sys.argv[1])
