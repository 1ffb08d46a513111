"""Plots error maps of each skin, error against pokes, and reliability of the sigmas. Without matplotlib nothing is drawn."""

from pathlib import Path

import numpy as np
import score

from . import report, tasks

COLOURS = ["#7f7f7f", "#e69f00", "#0072b2", "#56b4e9", "#d55e00", "#009e73", "#cc79a7", "#000000"]
MARKERS = "xso^vDPp"
# Expected shares at which the reliability diagram is drawn.
LEVELS = np.linspace(0.02, 0.98, 49)


def save(plt, figure, path):
    """Saves a picture with 128 colours, at a third of the size."""
    figure.savefig(path, dpi=100)
    plt.close(figure)
    from PIL import Image  # Comes with matplotlib.

    with Image.open(path) as image:
        small = image.convert("RGB").quantize(128)
    small.save(path, optimize=True)


def colour_of(names):
    return {name: (COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]) for index, name in enumerate(names)}


def error_against_pokes(plt, rows, path):
    """One panel per skin: median error of each method against the number of pokes, both axes logarithmic."""
    skins, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("set", "method"))
    colours = colour_of(methods)
    columns = min(4, len(skins))
    lines = -(-len(skins) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(3.1 * columns, 2.9 * lines), sharey=True, squeeze=False)
    for index, skin in enumerate(skins):
        axis = axes.flat[index]
        for method in methods:
            groups = report.gathered([row for row in rows if row["set"] == skin and row["method"] == method], "size")
            points = sorted((int(size[0]), [row["median"] for row in draws]) for size, draws in groups.items())
            if points:
                colour, marker = colours[method]
                axis.plot([size for size, _ in points], [np.mean(draws) for _, draws in points], color=colour, marker=marker, ms=4, lw=1.3, label=method)
        axis.set(xscale="log", yscale="log", title=skin, xlim=(8, 2000))
        axis.set_xticks([10, 50, 400, 1500], ["10", "50", "400", "1,500"], minor=False)
        axis.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    for axis in axes.flat[len(skins) :]:
        axis.remove()
    for line in axes:
        line[0].set_ylabel("median error, mm")
    figure.supxlabel("pokes", fontsize=10)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=min(len(labels), 6), frameon=False, fontsize=9)
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.1 / lines))
    save(plt, figure, path)


def collected(cases, method, folder):
    """True places, errors and ratios of error to sigma for one method over the cases, without misses."""
    places, errors, ratios = [], [], []
    for case in cases:
        path = folder / method / case.path
        if not path.is_file():
            continue
        touches = score.read_touches(path, ("x_mm", "y_mm"))
        for frame, truth in zip(case.rows, case.truth):
            values, sigma = touches.get(int(frame), [(np.full(2, np.nan), None)])[0]
            if np.isfinite(values).all():
                places.append(truth)
                errors.append(np.linalg.norm(values - truth))
                if sigma is not None:
                    ratios.append(np.abs(values - truth) / sigma)
    return np.array(places), np.array(errors), np.array(ratios)


def error_maps(plt, cases, methods, folder, path):
    """Skins across, methods down: the error at each judged press, with the same colour scale for all."""
    skins = list(dict.fromkeys(case.set for case in cases))
    figure, axes = plt.subplots(len(methods), len(skins), figsize=(1.75 * len(skins) + 0.9, 1.75 * len(methods) + 0.4), squeeze=False)
    drawn = None
    for line, method in zip(axes, methods):
        for axis, skin in zip(line, skins):
            places, errors, _ = collected([case for case in cases if case.set == skin], method, folder)
            axis.set(xticks=[], yticks=[], aspect="equal")
            if len(places):
                drawn = axis.scatter(*places.T, c=errors, s=6, cmap="viridis", vmin=0, vmax=15, linewidths=0)
        line[0].set_ylabel(method, fontsize=9)
    for axis, skin in zip(axes[0], skins):
        axis.set_title(skin, fontsize=9)
    figure.tight_layout(rect=(0, 0, 0.93, 1))
    if drawn is not None:
        bar = figure.colorbar(drawn, cax=figure.add_axes((0.94, 0.1, 0.012, 0.8)), extend="max")
        bar.set_label("error, mm")
    save(plt, figure, path)


def reliability(plt, groups, methods, folder, path):
    """One panel per number of pokes: actual against expected share of errors in an interval. The diagonal is right."""
    from statistics import NormalDist

    limits = np.array([NormalDist().inv_cdf(0.5 + level / 2) for level in LEVELS])
    colours = colour_of(methods)
    figure, axes = plt.subplots(1, len(groups), figsize=(3.2 * len(groups), 3.7), sharey=True, squeeze=False)
    for axis, (size, cases) in zip(axes[0], groups.items()):
        axis.plot([0, 1], [0, 1], color="black", lw=0.8, ls="--")
        for method in methods:
            _, _, ratios = collected(cases, method, folder)
            if len(ratios):
                shares = (ratios.ravel()[None] <= limits[:, None]).mean(1)
                axis.plot(LEVELS, shares, color=colours[method][0], lw=1.4, label=method)
        axis.set(title=f"{size:,} pokes", xlim=(0, 1), ylim=(0, 1), aspect="equal", xlabel="share expected")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("share inside (above: too cautious)")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=min(len(labels), 6), frameon=False, fontsize=9)
    figure.tight_layout(rect=(0, 0, 1, 0.93))
    save(plt, figure, path)


def draw(data, rows, folder, images):
    """Draws all pictures into a folder. Returns their names and titles."""
    try:
        import matplotlib
    except ImportError:
        print("no pictures: matplotlib is not installed")
        return {}
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [row for row in rows if row["task"] == "place"]
    if not rows:
        return {}
    images.mkdir(parents=True, exist_ok=True)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    groups = {}
    for case in tasks.place(data):
        groups.setdefault(int(case.size), []).append(case)
    groups = dict(sorted(groups.items()))
    error_against_pokes(plt, rows, images / "benchmark-pokes.png")
    maps = [case for case in groups.get(50, []) if case.part == "50.1"]
    error_maps(plt, maps, methods, Path(folder), images / "benchmark-maps.png")
    reliability(plt, groups, methods, Path(folder), images / "benchmark-reliability.png")
    return {
        "benchmark-pokes.png": "Median error against the number of pokes, one panel a skin",
        "benchmark-maps.png": "Error at each judged press after 50 pokes, one column a skin, one row a method",
        "benchmark-reliability.png": "Share of errors inside the interval that should hold that share, one panel a number of pokes",
    }
