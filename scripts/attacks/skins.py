"""Skin files and tables that ask for too much, name something that isn't a file, or hold invalid values."""

import copy
import json
import math
import os
import re
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .tools import PANIC, attack, check

HEAD = 'name = "attack"\nmodality = "eit"\n'
BACKEND = '[backend]\ncurrent_ma = 1.0\ndrive = "adjacent"\nmeasure = "adjacent"\n'
DISC = "{ disc = { diameter_mm = 100.0 } }"
RIM = "{ rim = { count = 16, width_mm = 5.0 } }"
LAYER = '{ kind = "sheet", thickness_mm = 1.0, conductivity_s_per_m = 1.0 }'


def frontend(shape=DISC, electrodes=RIM):
    return f"[frontend]\nshape = {shape}\nlayer = {LAYER}\nelectrodes = {electrodes}\ncontact_impedance_ohm_m2 = 1e-4\n"


def refused(ground, what, skin, names, seconds=10, memory_mb=400):
    """Checks that a skin is refused at once, with the key to change, before it has taken memory or time."""
    asked = ground.ask("run", skin, "--headless", "--frames", 1, timeout=seconds + 60)
    text = asked.err()
    said = [line for line in text.splitlines() if line.startswith("error")] or text.splitlines()
    said = re.sub(re.escape(str(ground.folder)) + "/", "", " ".join(said))[:230]
    ground.say(f"{what}: status {asked.code}, {asked.took:.1f} s, {asked.peak_mb():.0f} MB: {said}")
    check(asked.code == 2, f"{what}: ended with {asked.code} and not with 2: {text[-500:]}")
    for name in names:
        check(name in text, f"{what}: the error does not name {name!r}: {text[-500:]}")
    check(asked.took < seconds, f"{what}: took {asked.took:.1f} s")
    check(asked.peak_mb() < memory_mb, f"{what}: took {asked.peak_mb():.0f} MB")


@attack("huge-skins", "grid = 512, a million drive pairs, 20,000 vertices, pad-grid of 30, 100 km by 1 um")
def huge_skins(ground):
    square = "shape = { square = { side_mm = 100.0 } }"
    healing = ground.ask("skins", "show", "healing-square").out()
    check(square in healing or "side_mm" in healing, "healing-square is shown without its shape")
    # Fitting touches of a liquid uses the interactions of all its pixels.
    liquid = ground.ask("skins", "show", "ionic-square").out()
    grid = ground.skin("grid.toml", re.sub(r"(?m)^grid = \d+", "grid = 512", liquid))
    refused(ground, "grid = 512", grid, ["imaging.grid = 512", "--memory"])
    for count, names in ((1_000_000, ["bytes; expected"]), (150_000, ["drive"])):
        pairs = ",".join(["[1,2]"] * count)
        text = (
            HEAD + frontend() + f'[backend]\ncurrent_ma = 1.0\nmeasure = "adjacent"\ndrive = {{ pairs = [{pairs}] }}\n'
        )
        refused(
            ground, f"{count} equal drive pairs", ground.skin("pairs.toml", text), names, memory_mb=1200, seconds=30
        )
    circle = [(50 * math.cos(2 * math.pi * k / 20000), 50 * math.sin(2 * math.pi * k / 20000)) for k in range(20000)]
    outer = ", ".join(f"[{x:.6f}, {y:.6f}]" for x, y in circle)
    text = HEAD + frontend(f"{{ polygon = {{ outer_mm = [{outer}] }} }}") + BACKEND
    refused(ground, "20,000 vertices", ground.skin("polygon.toml", text), ["2000"])
    text = HEAD + frontend("{ polygon = { outer_mm = [[0, 0], [1e8, 0], [1e8, 1e-3], [0, 1e-3]] } }") + BACKEND
    refused(ground, "100 km by 1 um", ground.skin("thin.toml", text), ["shape"])
    text = HEAD + frontend(electrodes="{ pad-grid = { per_side = 30, diameter_mm = 1.0 } }") + BACKEND
    pads = ground.skin("pads.toml", text)
    asked = ground.start("--memory", "2GB", "run", pads, "--headless", "--frames", 1)
    check(asked.wait(20) == 2, f"900 pads in 2 GB: ended with {asked.code}: {asked.err()[-400:]}")
    check("900 electrodes" in asked.err() and "--memory" in asked.err(), f"900 pads: {asked.err()[-400:]}")
    ground.say(f"pad-grid of 30 with --memory 2GB: status 2, {asked.took:.1f} s: {asked.err().strip()[:230]}")


@attack("long-line", "a table whose one line is 100 MB, and one of 100 MB of short lines without numbers")
def long_line(ground):
    for name, piece in {
        "digits.csv": b"1" * 10_000,
        "commas.csv": b"1," * 5_000,
        "words.csv": b"no number\n" * 1000,
    }.items():
        # Write in pieces, because this process's memory limit also applies to its children.
        with (ground.folder / name).open("wb") as file:
            for _ in range(10_000):
                file.write(piece)
        asked = ground.ask(
            "reconstruct", "ionic-disc", "--baseline", name, "--frames", name, "--touches", "touches.csv"
        )
        ground.say(
            f"{name}, 100 MB: status {asked.code}, {asked.peak_mb():.0f} MB, {asked.took:.1f} s: {asked.err()[:160]!r}"
        )
        check(asked.code == 2, f"{name}: ended with {asked.code}: {asked.err()[-400:]}")
        check(asked.peak_mb() < 400, f"{name}: took {asked.peak_mb():.0f} MB")
        (ground.folder / name).unlink()


@attack("no-files", "devices, pipes, folders and endless files where a file is expected")
def no_files(ground):
    fifo = ground.folder / "pipe"
    os.mkfifo(fifo)
    (ground.folder / "folder").mkdir()
    (ground.folder / "sparse").touch()
    os.truncate(ground.folder / "sparse", 10**12)
    tried = 0
    for what in [
        "/dev/zero",
        "/dev/urandom",
        "/dev/stdin",
        str(fifo),
        "pipe",
        "folder",
        "sparse",
        "../../../dev/zero",
        "missing",
    ]:
        skin = ground.skin("parts.toml", f'{HEAD}backend = "{what}"\n{frontend()}')
        questions = [
            ["run", skin, "--headless", "--frames", "1"],
            ["skins", "show", what],
            ["info", what],
            ["export", what, "--out", "table.csv"],
            ["recover", what, "--out", "new.mcap"],
            ["run", "ionic-disc", "--headless", "--source", what],
            ["run", "ionic-disc", "--headless", "--frames", "1", "--calibration", what],
            ["run", "ionic-disc", "--headless", "--frames", "1", "--forces", what],
            ["run", "ionic-disc", "--headless", "--frames", "1", "--model", what],
            ["reconstruct", "ionic-disc", "--baseline", what, "--frames", what],
            ["solve", what],
            ["train", "--set", what, "--out", "model.json"],
        ]
        for question in questions:
            asked = ground.ask(*question, timeout=20)
            tried += 1
            check(asked.code in (1, 2), f"{asked.name}: ended with {asked.code}: {asked.err()[-300:]}")
            check(asked.peak_mb() < 500, f"{asked.name}: took {asked.peak_mb():.0f} MB")
    ground.say(f"{tried} commands on devices, pipes, folders, a sparse file of 1 TB and nothing: all refused")


def numbers(value, path=()):
    """Paths to the keys of a skin."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from numbers(inner, (*path, key))
    elif isinstance(value, list) and value and not all(isinstance(one, (int, float)) for one in value):
        for k, inner in enumerate(value[:2]):
            yield from numbers(inner, (*path, k))
    else:
        yield path


def toml(value):
    """A value as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return "nan" if math.isnan(value) else str(value)
    return json.dumps(value)


@attack("skin-magnitudes", "every numeric key of six skins at five magnitudes; memory and time from outside")
def skin_magnitudes(ground):
    cases = []
    em = Path(__file__).parents[2] / "skins/examples/em-3x4.toml"
    for name in ["healing-square", "ionic-disc", "piezo-disc", "hydrogel-disc", "em-8", em]:
        asked = ground.ask("skins", "show", name)
        name = Path(name).stem
        skin = tomllib.loads(asked.out())
        for path in numbers(skin):
            value = skin
            for step in path:
                value = value[step]
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                continue
            for factor in (1e-3, 1e-1, 10.0, 1e3, 1e6):
                changed = copy.deepcopy(skin)
                place = changed
                for step in path[:-1]:
                    place = place[step]
                scaled = value * factor
                place[path[-1]] = max(1, round(scaled)) if isinstance(value, int) else scaled
                text = "\n".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in changed.items())
                cases.append((name, ".".join(map(str, path)), place[path[-1]], text))
    ground.random.shuffle(cases)
    counts = {"refused": 0, "ran": 0}
    deadline = time.monotonic() + (ground.options.seconds or math.inf)
    worst = {"MB": (0.0, ""), "s": (0.0, "")}
    for name, key, value, text in cases:
        if time.monotonic() > deadline:
            break
        shown = f"{name}: {key} = {value}"
        path = ground.folder / "case.toml"
        path.write_text(text)
        table = ["--baseline", ground.folder / "rest.npy", "--frames", ground.folder / "presses.npy"]
        for words in (["twin", "sample", path, "--presses", "random:1", *table], ["skins", "show", path]):
            for file in table[1::2]:
                file.unlink(missing_ok=True)
            asked = ground.start("--memory", f"{MOST_MB}MB", *words, env={"DERMIS_CACHE": str(ground.folder / "cache")})
            try:
                asked.wait(MOST_S)
            finally:
                asked.kill()
            said = asked.err()
            check(not PANIC.search(said), f"{shown}: a panic: {said[-400:]}")
            check(asked.code in (0, 1, 2, 3), f"{shown}: {words[0]} ended with {asked.code}: {said[-400:]}")
            check(asked.peak_mb() < 2.0 * MOST_MB, f"{shown}: {words[0]} took {asked.peak_mb():.0f} MB of {MOST_MB}")
            worst["MB"] = max(worst["MB"], (asked.peak_mb(), shown))
            worst["s"] = max(worst["s"], (asked.took, shown))
            ground.processes.remove(asked)
            for file in (asked.out_file, asked.err_file):
                os.unlink(file.name)
                file.close()
        counts["ran" if asked.code == 0 else "refused"] += 1
    tried = sum(counts.values())
    ground.say(f"{tried} of {len(cases)} skins tried: {counts['refused']} refused, {counts['ran']} shown")
    for unit, (most, shown) in worst.items():
        ground.say(f"most: {most:.1f} {unit} ({shown})")
    check(tried >= min(len(cases), 20), "too few were tried")


# Memory given to every skin, and the longest time that one may take with it.
MOST_MB = 1000
MOST_S = 300


@attack("skin-keys", "every key of six skins with NaN, inf, -1, 0, 1e-300, 1e300, an empty and a huge text")
def skin_keys(ground):
    drawn = [math.nan, math.inf, -1.0, 0.0, 1e-300, 1e300, "", "x" * 100_000, -1, 0, 2**63 - 1]
    cases = []
    for name in ["healing-square", "ionic-disc", "piezo-disc", "hydrogel-disc", "em-8", "ktc-tank"]:
        skin = tomllib.loads(ground.ask("skins", "show", name).out())
        for path in numbers(skin):
            for value in drawn:
                changed = copy.deepcopy(skin)
                place = changed
                for step in path[:-1]:
                    place = place[step]
                place[path[-1]] = value
                text = "\n".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in changed.items())
                cases.append((name, ".".join(map(str, path)), value, text))
    ground.random.shuffle(cases)
    counts = {"refused": 0, "ran": 0}
    deadline = time.monotonic() + (ground.options.seconds or math.inf)

    def one(case):
        name, key, value, text = case
        if time.monotonic() > deadline:
            return None
        shown = f"{name}: {key} = {str(value)[:20]}"
        path = ground.folder / f"case-{id(case)}.toml"
        path.write_text(text)
        asked = ground.start("--memory", "2GB", "run", path, "--headless", "--frames", 2, "--speed", 0)
        try:
            asked.wait(120)
        finally:
            asked.kill()
        said = asked.err()
        check(not PANIC.search(said), f"{shown}: a panic: {said[-400:]}")
        check(asked.code in (0, 1, 2, 3), f"{shown}: ended with {asked.code}: {said[-400:]}")
        ground.processes.remove(asked)
        path.unlink()
        for file in (asked.out_file, asked.err_file):
            os.unlink(file.name)
            file.close()
        if asked.code in (1, 2):
            words = [word for word in key.split(".") if not word.isdigit()]
            # The key itself, or the table that it makes invalid.
            check(any(word in said for word in words), f"{shown}: the error names no key: {said[-300:]}")
            return "refused"
        return "ran"

    with ThreadPoolExecutor(2) as pool:
        for outcome in pool.map(one, cases):
            if outcome:
                counts[outcome] += 1
    tried = sum(counts.values())
    ground.say(
        f"{tried} of {len(cases)} skins tried: {counts['refused']} refused by name of the key, {counts['ran']} ran"
    )
    check(tried >= min(len(cases), 100), "too few were tried")
