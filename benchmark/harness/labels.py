"""Checks whether labels belong to their frames: a permutation test, a search for lags, and a test for mirrored labels.

Similar frames should be presses near each other. Each place is predicted from the three most similar other frames, and the
median error is compared with the errors for shuffled labels and for labels moved by some rows. A mirror of all labels is
invisible in a single session without the places of the electrodes; a second session of the same skin reveals it.
"""

import numpy as np

NEIGHBOURS = 3
SHUFFLES = 199
# Lags of the labels to test, in rows.
LAGS = (1, -1, 2, -2, 3, -3)
# p-value above which labels don't belong to the frames.
LARGEST_P = 0.05
# Accept a moved or mirrored table only if it lowers the error to this share.
GAIN = 0.7
FEWEST, MOST = 12, 800
TURNS = {
    "x mirrored": [[-1, 0], [0, 1]], "y mirrored": [[1, 0], [0, -1]], "turned by 180 degrees": [[-1, 0], [0, -1]],
    "x and y exchanged": [[0, 1], [1, 0]], "x and y exchanged and mirrored": [[0, -1], [-1, 0]],
    "turned by 90 degrees": [[0, -1], [1, 0]], "turned by -90 degrees": [[0, 1], [-1, 0]],
}  # fmt: skip


def unit(frames, scale):
    scaled = frames / scale
    return scaled / (np.linalg.norm(scaled, axis=1, keepdims=True) + 1e-12)


def nearest(first, second, is_same=False):
    """Rows of `second` that are most similar to each row of `first`."""
    likeness = first @ second.T
    if is_same:
        np.fill_diagonal(likeness, -np.inf)
    return np.argpartition(-likeness, NEIGHBOURS - 1, axis=1)[:, :NEIGHBOURS]


def error(near, places):
    """Median distance between each place and the mean of its neighbours' places."""
    return float(np.median(np.linalg.norm(places[near].mean(1) - places, axis=1)))


def examine(frames, places, seed=1):
    """Findings for one session: p-value, errors, and the lag that fits far better, if any."""
    frames, places = np.asarray(frames, float)[:MOST], np.asarray(places, float)[:MOST, :2]
    if len(frames) < FEWEST:
        return {"pokes": len(frames), "verdict": f"too few pokes to tell: {len(frames)}, at least {FEWEST} are needed", "is_bad": False}
    near = nearest(*[unit(frames, frames.std(0) + 1e-12)] * 2, is_same=True)
    found, random = error(near, places), np.random.default_rng(seed)
    shuffled = [error(near, places[random.permutation(len(places))]) for _ in range(SHUFFLES)]
    p_value = (1 + sum(other <= found for other in shuffled)) / (1 + SHUFFLES)
    moved = {lag: error(near, np.roll(places, -lag, axis=0)) for lag in LAGS}
    lag = min(moved, key=moved.get)
    result = {"pokes": len(frames), "p": p_value, "error": found, "shuffled": float(np.median(shuffled)), "lag": None, "is_bad": True}
    # The moved table must also beat all shuffled ones.
    if moved[lag] < GAIN * found and moved[lag] < min(shuffled):
        rows = f"{abs(lag)} row" + ("s" if abs(lag) > 1 else "")
        return result | {"lag": lag, "verdict": f"labels {'lag' if lag > 0 else 'lead'} by {rows}"}
    if p_value > LARGEST_P:
        return result | {"verdict": "labels and frames do not belong together"}
    return result | {"verdict": "labels belong to their frames", "is_bad": False}


def mirrored(old, new):
    """How the labels of a new session are rotated or mirrored against an old one, in words. None if they are not."""
    (old_frames, old_places), (new_frames, new_places) = ((frames[:MOST], places[:MOST, :2]) for frames, places in (old, new))
    scale = old_frames.std(0) + 1e-12
    guess = old_places[nearest(unit(new_frames, scale), unit(old_frames, scale))].mean(1)
    plain = float(np.median(np.linalg.norm(guess - new_places, axis=1)))
    turned = {words: float(np.median(np.linalg.norm(guess - new_places @ np.array(turn), axis=1))) for words, turn in TURNS.items()}
    words = min(turned, key=turned.get)
    return (words, plain, turned[words]) if turned[words] < GAIN * plain else (None, plain, turned[words])
