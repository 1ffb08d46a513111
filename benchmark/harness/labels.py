"""Do the labels of pokes belong to their frames? A permutation test, labels that lag, and a mirror against a second session.

Frames that look alike should be presses near each other. Each place is predicted from the three other frames that are most
alike; the median error is compared with that of shuffled labels, and of labels moved by some rows. A mirror of all labels
cannot be told from one session alone, nor without the places of the electrodes; a second session of the same skin tells it.
"""

import numpy as np

NEIGHBOURS = 3
SHUFFLES = 199
# Rows by which labels may lag or lead.
LAGS = (1, -1, 2, -2, 3, -3)
# Labels that do no better than this share of the shuffles do not belong to the frames.
LARGEST_P = 0.05
# A moved or mirrored table is believed where it lowers the error to this share.
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
    """Rows of `second` that are most alike to each row of `first`."""
    likeness = first @ second.T
    if is_same:
        np.fill_diagonal(likeness, -np.inf)
    return np.argpartition(-likeness, NEIGHBOURS - 1, axis=1)[:, :NEIGHBOURS]


def error(near, places):
    """Median distance of each place from the mean of those nearby."""
    return float(np.median(np.linalg.norm(places[near].mean(1) - places, axis=1)))


def examine(frames, places, seed=1):
    """Findings on one session: p-value, errors, and the lag that fits far better, if any."""
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
    # A lag is read off the shuffles too: the moved table has to beat all of them.
    if moved[lag] < GAIN * found and moved[lag] < min(shuffled):
        rows = f"{abs(lag)} row" + ("s" if abs(lag) > 1 else "")
        return result | {"lag": lag, "verdict": f"labels {'lag' if lag > 0 else 'lead'} by {rows}"}
    if p_value > LARGEST_P:
        return result | {"verdict": "labels and frames do not belong together"}
    return result | {"verdict": "labels belong to their frames", "is_bad": False}


def mirrored(old, new):
    """How the labels of a new session are turned against an old one of the same skin: words, or None if they are not."""
    (old_frames, old_places), (new_frames, new_places) = ((frames[:MOST], places[:MOST, :2]) for frames, places in (old, new))
    scale = old_frames.std(0) + 1e-12
    guess = old_places[nearest(unit(new_frames, scale), unit(old_frames, scale))].mean(1)
    plain = float(np.median(np.linalg.norm(guess - new_places, axis=1)))
    turned = {words: float(np.median(np.linalg.norm(guess - new_places @ np.array(turn), axis=1))) for words, turn in TURNS.items()}
    words = min(turned, key=turned.get)
    return (words, plain, turned[words]) if turned[words] < GAIN * plain else (None, plain, turned[words])
