"""Tables of scores in Markdown, one per task, with the information given to methods and the meaning of the columns."""

import math
from pathlib import Path

MARKS = ("<!-- benchmark:begin -->", "<!-- benchmark:end -->")
TOLD = {
    "place": "Told: labelled pokes, as differences from the untouched skin; no outline, electrodes or protocol. Judged: "
    "single presses of the same session. Errors in mm.",
    "session": "Told: one labelled session. Judged: the same skin in a later session. The gel membrane of `hydrogel-"
    "damage` was pressed 15 times along a line of unknown length, so places and errors are numbers of presses.",
    "damaged": "Told: 1,000 labelled pokes of the undamaged skin, and the given number of pokes of the damaged one. "
    "*unchanged*: only old pokes; *alone*: only new ones; *pooled*: both, unmarked; *own*: both, marked. "
    "Judged: other presses of the damaged skin. Errors in mm.",
    "lines": "Told: the 15 presses of the uncut membrane. Judged: the same line after cuts, and healed. Errors in "
    "numbers of presses, mean over the runs.",
    "several": "Told: presses of a gel disc, and which of six points they touched; *singles*: one at a time, *all*: every "
    "pattern, both from another batch; *within*: every pattern, from half of the judged batch. Judged: all 63 "
    "patterns, and 100 untouched frames (differences of neighbouring frames before presses).",
    "unlabelled": "Told: outline, electrodes, protocol and the untouched frames of the gel disc; no position and no pressed "
    "frame. Errors in mm.",
    "depth": "Told: 400 pokes with place and depth. Judged: the depth of other presses of the session, which has two or "
    "three depths. Errors in mm.",
    "segmentation": "Told: diameter, electrodes, currents, one frame of the empty tank. Judged: the four training phantoms at "
    "the challenge's levels 1 to 7 (none to twelve of 32 electrodes lost), by its score: 1 is perfect, an empty"
    " label 0.264.",
    "watch": "Told: 64 frames of the untouched skin, eight seconds apart, then every frame in turn. Judged: alarms. "
    "Steps above three times the median show two events, whose times are not published: frames 490 to 505, "
    "after which the levels return, and 663 to 665, after which they stay changed. Alarms up to 30 frames after"
    " an event belong to it; what follows the second is not judged. A false alarm is a run of frames.",
    "speed": "One frame at a time on one core, at the largest number of pokes. Preparation lies between the labels and "
    "the first frame.",
}
TITLES = {
    "place": "Place", "session": "New session", "damaged": "Damaged", "lines": "Cut and healed", "several": "Several touches",
    "unlabelled": "Unlabelled", "depth": "Depth", "segmentation": "Segmentation", "watch": "Drift and damage watch", "speed": "Speed",
}  # fmt: skip
VALUES = ("median", "p90", "inside_1", "inside_2.5", "nll", "misses", "false")


def number(value, digits=3):
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, float) and math.isinf(value):
        return "none"
    if isinstance(value, int):
        return f"{value:,}"
    if not value:
        return "0"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):,.{max(places, 0)}f}"


def percent(value):
    return "-" if value is None or math.isnan(value) else f"{100 * value:.0f} %"


def mean(values):
    return math.fsum(values) / len(values) if values else math.nan


def known(values):
    """Those that were measured."""
    return [value for value in values if not math.isnan(value)]


def gathered(rows, *keys):
    """Groups rows by equal keys, in order of first occurrence."""
    groups = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def averaged(rows):
    """Means of the scores over draws; misses and superfluous touches are added up."""
    found = {key: mean([row[key] for row in rows]) for key in ("median", "p90", "rms", "inside_1", "inside_2.5", "nll")}
    return found | {key: sum(row[key] for row in rows) for key in ("misses", "false", "frames")}


def table(head, rows, is_short=False):
    kept = [column for column, name in enumerate(head) if not (is_short and name in LEFT_OUT)]
    head, rows = [head[column] for column in kept], [[row[column] for column in kept] for row in rows]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows]) + "\n"


def amount(cell):
    """The number in a cell: infinite for `none`, NaN for a dash."""
    text = cell.split(" (")[0].rstrip(" %").replace(",", "")
    special = {"none": math.inf, "-": math.nan}
    return special[text] if text in special else float(text)


def best_plain(head, lines, plain, by, better=min):
    """Of the plain methods in a group of lines, keeps only the best. All cells before the method's name define the group."""
    method, column = head.index("method"), head.index(by)
    best = {}
    for line in lines:
        if line[method] in plain and not math.isnan(amount(line[column])):
            best.setdefault(tuple(line[:method]), []).append(line)
    chosen = [better(group, key=lambda line: amount(line[column])) for group in best.values()]
    return [line for line in lines if line[method] not in plain or any(line is other for other in chosen)]


# Columns left out where only the best plain method is shown.
LEFT_OUT = ("inside 2.5 sigma", "too many", "calls per second", "points right", "number right")
HEAD = ["median", "90th percentile", "inside 1 sigma", "inside 2.5 sigma", "negative log likelihood", "misses", "too many"]


def cells(score):
    return [
        number(score["median"]), number(score["p90"]), percent(score["inside_1"]), percent(score["inside_2.5"]),
        number(score["nll"]), f"{score['misses']} of {score['frames']:,}", number(score["false"]),
    ]  # fmt: skip


def place_summary(rows, times, plain=()):
    """Summary over the skins: geometric means of errors, ranges of shares, means of likelihoods."""
    lines = []
    for (size, method), group in gathered(sorted(rows, key=lambda row: int(row["size"])), "size", "method").items():
        skins = [averaged(draws) for draws in gathered(group, "set").values()]
        geometric = {
            key: math.exp(mean([math.log(skin[key]) for skin in skins])) if all(0 < skin[key] < math.inf for skin in skins) else math.inf
            for key in ("median", "p90")
        }
        inside = [skin["inside_1"] for skin in skins]
        spread = "-" if math.isnan(mean(inside)) else f"{percent(mean(inside))} ({100 * min(inside):.0f} to {100 * max(inside):.0f})"
        speed = known(times[key][1] for key in times if key[:2] == (method, "place") and key[3].split(".")[0] == size)
        lines.append([
            f"{int(size):,}", method, str(len(skins)), number(geometric["median"]), number(geometric["p90"]), spread,
            percent(mean([skin["inside_2.5"] for skin in skins])), number(mean([skin["nll"] for skin in skins])),
            f"{sum(skin['misses'] for skin in skins)} of {sum(skin['frames'] for skin in skins):,}",
            number(sum(skin["false"] for skin in skins)), number(mean(speed), 2),
        ])  # fmt: skip
    head = ["pokes", "method", "skins", *HEAD, "calls per second"]
    return table(head, best_plain(head, lines, plain, "median"), bool(plain))


def depths(rows, plain=()):
    """Puts the root mean square first: most presses of a set have the same depth, so the median says little."""
    lines = [[*key, number(score["rms"]), *cells(score)] for key, score in ((key, averaged(group)) for key, group in gathered(rows, "set", "method").items())]
    head = ["set", "method", "root mean square", *HEAD]
    return table(head, best_plain(head, lines, plain, "root mean square"), bool(plain))


def by_set(rows, keys=("set", "size", "method"), plain=()):
    lines = [[f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in key] + cells(averaged(group)) for key, group in gathered(rows, *keys).items()]
    head = [{"set": "set", "size": "pokes", "strategy": "told", "task": "runs"}.get(key, key) for key in keys] + HEAD
    return table(head, best_plain(head, lines, plain, "median"), bool(plain))


def points(rows, plain=()):
    lines = [
        [row["part"], row["size"], row["method"], percent(row["patterns"]), percent(row["doubles"]), percent(row["points"]), percent(row["count"]),
         number(row["misses"]), number(row["false"]), number(row["quiet_false"])]
        for row in rows
    ]  # fmt: skip
    head = ["told", "presses", "method", "patterns right", "doubles right", "points right", "number right", "misses", "false touches",
            "false touches on 100 untouched frames"]  # fmt: skip
    return table(head, best_plain(head, lines, plain, "patterns right", max), bool(plain))


def levels(rows, plain=()):
    lines = []
    for (method,), group in gathered(rows, "method").items():
        scores = {row["size"]: row["score"] for row in group}
        lines.append([method, *(number(scores.get(str(level), math.nan)) for level in range(1, 8)), number(mean(list(scores.values())) if len(scores) == 7 else math.nan)])
    head = ["method", *(f"level {level}" for level in range(1, 8)), "mean"]
    return table(head, best_plain(head, lines, plain, "mean", max))


def alarms(rows, plain=()):  # noqa: ARG001  No single score ranks watches: all are shown.
    lines = [
        [row["method"], number(row["false"]), number(row["false_frames"]), *("not found" if math.isnan(late) else f"{late:.0f}" for late in row["delays"])]
        for row in rows
    ]
    return table(["method", "false alarms", "frames of them", "first event found after, frames", "second"], lines)


def speeds(times):
    """Speed of each method at its largest training size."""
    lines = []
    for method in dict.fromkeys(key[0] for key in times):
        found = [(int(key[3].split(".")[0]), value) for key, value in times.items() if key[:2] == (method, "place")]
        if found:
            most = max(size for size, _ in found)
            chosen = [value for size, value in found if size == most]
            lines.append([method, f"{most:,}", number(mean([value[0] for value in chosen]), 2), number(mean(known(value[1] for value in chosen)), 2)])
    return table(["method", "pokes", "prepared in, s", "calls per second"], lines)


def section(name, body):
    return f"### {TITLES[name]}\n\n{TOLD[name]}\n\n{body}"


def tables(rows, times, is_full=True, plain=()):
    """All tables. Without `is_full`, places are only summarised over the skins. Of the methods in `plain`, each group of lines shows
    the best in fewer columns; tasks that only they entered, and speeds, are left out."""
    kind = lambda row: (row["task"], bool(row.get("strategy")))  # noqa: E731
    entered = {kind(row) for row in rows if row["method"] not in plain}
    of = lambda *names: [row for row in rows if row["task"] in names and kind(row) in entered]  # noqa: E731
    parts = []
    if of("place"):
        body = "Over the skins: errors are geometric means, shares means with the smallest and the largest skin.\n\n" + place_summary(of("place"), times, plain)
        parts.append(section("place", body + ("\nEach skin, mean over the draws:\n\n" + by_set(of("place")) if is_full else "")))
    if of("session"):
        parts.append(section("session", by_set(of("session"), plain=plain)))
    pairs = [row for row in of("damaged") if row["strategy"]]
    if pairs:
        parts.append(section("damaged", by_set(sorted(pairs, key=lambda row: int(row["size"])), ("size", "strategy", "method"), plain)))
    runs = [row for row in of("damaged", "healed") if not row["strategy"]]
    if runs:
        parts.append(section("lines", by_set(runs, ("task", "method"), plain)))
    for name, body in (("several", points), ("unlabelled", by_set), ("depth", depths), ("segmentation", levels), ("watch", alarms)):
        if of(name):
            parts.append(section(name, body(of(name), plain=plain)))
    if of("place") and times and not plain:
        parts.append(section("speed", speeds(times)))
    return "\n".join(parts)


def between_marks(page, text):
    """Replaces the text between a page's marks. Raises ValueError if there are no marks."""
    content = Path(page).read_text(encoding="utf-8")
    begin, end = content.find(MARKS[0]), content.find(MARKS[1])
    if begin < 0 or end < begin:
        raise ValueError(f"{page}: no lines {MARKS[0]} and {MARKS[1]}")
    Path(page).write_text(content[: begin + len(MARKS[0])] + "\n\n" + text + "\n" + content[end:], encoding="utf-8")
