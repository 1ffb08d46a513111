"""Checks standard deviations: random presses on a skin's twin, errors in units of sigma: `scripts/press-anywhere
--sigmas`.

Single presses, pairs and triples, with discs 1.5 times the necessary distance apart, one frame each. Radii are 0.6 to
1.4 times the usual one and pressures 0.3 to 2 times, both uniform in their logarithms; places are anywhere within 85 %
of the outline.
"""

import itertools
import math
import pathlib
import random
import tomllib

from twin_presses import Outline, built_in_file, place, seen, usual_press, write_presses

RADII = (0.6, 1.4)
PRESSURES = (0.3, 2.0)
# Distance between the discs of simultaneous presses, in units of the sum of their radii.
APART = 1.5
# Simultaneous touches count as separated if each is within this share of the longer side from its press.
NEAR = 0.125
# Presses in the outermost fifth count as near the rim.
RIM_SHARE = 0.2
# Required shares of errors within one sigma and within two and a half.
WITHIN_ONE = (0.60, 0.76)
WITHIN_MORE = 0.95
MORE = 2.5


def log_uniform(dice, low, high):
    return math.exp(dice.uniform(math.log(low), math.log(high)))


def groups_at_random(outline, usual, at_once, presses, dice):
    """Groups of presses that keep clear of each other."""
    radius, pressure = usual
    groups = []
    while len(groups) < -(-presses // at_once):
        group, tried = [], 0
        while len(group) < at_once and tried < 200:
            tried += 1
            (x, y), size = outline.places(1, dice)[0], radius * log_uniform(dice, *RADII)
            if all(math.hypot(x - other[0], y - other[1]) > APART * (size + other[2]) for other in group):
                group.append([x, y, size, pressure * log_uniform(dice, *PRESSURES)])
        if len(group) == at_once:
            groups.append(group)
        elif not groups and tried == 200:
            return []
    return groups


def nearest_order(touches, group):
    """The touches, assigned to their presses so that the total distance is smallest."""
    away = lambda order: sum(math.dist(place(touch), press[:2]) for touch, press in zip(order, group))  # noqa: E731
    return min(itertools.permutations(touches, len(group)), key=away)


def coordinates(outline, groups, found):
    """For each press that was found: errors and sigmas (mm) in x and y, position and strength."""
    near = NEAR * max(outline.sides_mm)
    entries, complete = [], 0
    for frame, group in enumerate(groups):
        touches = found.get(frame, [])
        if len(group) == 1:
            order = sorted(touches, key=lambda touch: math.dist(place(touch), group[0][:2]))[:1]
        elif len(touches) == len(group):
            order = nearest_order(touches, group)
            if any(math.dist(place(touch), press[:2]) > near for touch, press in zip(order, group)):
                continue
        else:
            continue
        complete += bool(order)
        for touch, press in zip(order, group):
            x, y = place(touch)
            entries.append(
                {
                    "errors": (x - press[0], y - press[1]),
                    "sigmas": (float(touch["sigma_x_mm"]), float(touch["sigma_y_mm"])),
                    "from_rim": outline.from_rim_mm(press[:2]),
                    "pressure": press[3],
                    "radius": press[2],
                    "place": press[:2],
                    "amplitude": float(touch["amplitude"]),
                }
            )
    return entries, complete


def shares(entries):
    """Shares of errors within one sigma and within 2.5, the 68th percentile of errors and the median sigma, mm."""
    pairs = [(abs(e), s) for entry in entries for e, s in zip(entry["errors"], entry["sigmas"])]
    if not pairs:
        return None
    errors, sigmas = sorted(e for e, _ in pairs), sorted(s for _, s in pairs)
    return {
        "one": sum(e <= s for e, s in pairs) / len(pairs),
        "more": sum(e <= MORE * s for e, s in pairs) / len(pairs),
        "error": errors[int(0.683 * (len(errors) - 1))],
        "sigma": sigmas[len(sigmas) // 2],
        "count": len(entries),
    }


def split(entries):
    """Entries grouped by strength and by position."""
    by_pressure = sorted(entries, key=lambda entry: entry["pressure"])
    by_rim = sorted(entries, key=lambda entry: entry["from_rim"])
    half, rim = len(entries) // 2, round(RIM_SHARE * len(entries))
    return {
        "light": by_pressure[:half],
        "hard": by_pressure[half:],
        "rim": by_rim[:rim],
        "inner": by_rim[rim:],
    }


def measured(skin, options, folder):
    """Rows of the table for one skin: number of simultaneous presses, groups found, shares, and all errors."""
    path = pathlib.Path(skin) if str(skin).endswith(".toml") else built_in_file(skin)
    outline = Outline(tomllib.loads(path.read_text())["frontend"]["shape"])
    usual = usual_press(folder, skin)
    lines = []
    for at_once in options.at_once:
        dice = random.Random(f"{options.seed} {at_once}")
        groups = groups_at_random(outline, usual, at_once, options.presses, dice)
        if not groups:
            continue
        table = folder / f"at-once-{at_once}.csv"
        write_presses(table, groups)
        _, found = seen(folder, skin, table, 1, 10 * options.seed + at_once, options.again)
        entries, complete = coordinates(outline, groups, found)
        parts = {"all": entries} | (split(entries) if at_once == 1 else {})
        lines.append((at_once, f"{complete} of {len(groups)}", {part: shares(of) for part, of in parts.items()}, entries))
    return lines


def is_held(share):
    """True if the shares meet the requirements, within the scatter of this number of presses."""
    # The two errors of a press are partly correlated: count one and a half coordinates per press.
    scatter = lambda p: math.sqrt(p * (1.0 - p) / (1.5 * share["count"]))  # noqa: E731
    one = WITHIN_ONE[0] - scatter(WITHIN_ONE[0]) <= share["one"] <= WITHIN_ONE[1] + scatter(WITHIN_ONE[1])
    return one and share["more"] >= WITHIN_MORE - scatter(WITHIN_MORE)


def shown(share):
    if share is None:
        return "-"
    mark = "" if is_held(share) else " *"
    return f"{100 * share['one']:.0f}, {100 * share['more']:.0f}{mark}"


HEAD = (
    f"| {'skin':<20} | at once | found | 68 % mm | sigma mm | within 1, 2.5: % | light | hard | near the rim | inner |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def printed(name, lines):
    for at_once, complete, by_part, _ in lines:
        whole = by_part["all"]
        size = f"{whole['error']:.3f} | {whole['sigma']:.3f}" if whole else "- | -"
        parts = " | ".join(shown(by_part.get(part)) for part in ("all", "light", "hard", "rim", "inner"))
        print(f"| {name:<20} | {at_once} | {complete} | {size} | {parts} |", flush=True)
