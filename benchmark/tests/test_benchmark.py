"""The benchmark on synthetic data: scores against values worked out by hand, splits, baselines, labels, external methods."""

import csv
import importlib.util
import math
import os
import struct
import subprocess
import sys
import zlib
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(HERE))

import score  # noqa: E402
from baselines import gauss_newton, gauss_newton_image, gaussian_process, kernel_ridge, mean, nearest  # noqa: E402
from harness import data, labels, mat5, methods, report, splits, tasks  # noqa: E402

CHANNELS = 24


def skin(count, seed=0, noise=0.02, size=0.04):
    """Frames and places (m) of a synthetic skin. Channels are bumps spread over a square, scaled by the depth of the press."""
    random = np.random.default_rng(seed)
    centres = np.random.default_rng(99).uniform(-size, size, (CHANNELS, 2))
    signs = np.where(np.arange(CHANNELS) % 3 == 0, -1, 1)
    places = np.column_stack([random.uniform(-size, size, (count, 2)), random.choice([0.001, 0.002], count)])
    away = np.linalg.norm(places[:, None, :2] - centres[None], axis=2)
    frames = signs * np.exp(-(away**2) / (2 * 0.02**2)) * places[:, 2:] * 1000
    return frames + noise * random.standard_normal(frames.shape), places


def write_skin(folder, count, seed=0):
    frames, places = skin(count, seed)
    folder.mkdir(parents=True)
    np.savetxt(folder / "differences.csv", frames, delimiter=",", fmt="%.7g")
    np.savetxt(folder / "positions.csv", places, delimiter=",", fmt="%.6f", header="x_m,y_m,depth_m", comments="")


def predictions(path, lines, head="frame,x_mm,y_mm,sigma_x_mm,sigma_y_mm"):
    path.write_text("\n".join([head, *lines]) + "\n")
    return score.read_touches(path, ("x_mm", "y_mm"))


def test_scores_of_places_are_those_worked_out_by_hand(tmp_path):
    touches = predictions(tmp_path / "p.csv", ["0,3,4,4,2", "0,nan,nan,nan,nan", "1,0,2,1,1"])
    found = score.score_values([[0, 0], [0, 0], [10, 20]], [0, 1, 2], touches)
    # Errors 5, 2 and a miss; ratios 0.75, 2, 0, 2; the box of the truth is 10 x 20.
    assert found["median"] == pytest.approx(5)
    assert math.isinf(found["p90"])
    assert (found["misses"], found["false"]) == (1, 1)
    assert found["inside_1"] == pytest.approx(0.5) and found["inside_2.5"] == pytest.approx(1)
    likelihoods = [0.5 * (0.75**2 + 2**2) + math.log(8 * 2 * math.pi), 0.5 * 4 + math.log(2 * math.pi), math.log(200)]
    assert found["nll"] == pytest.approx(sum(likelihoods) / 3)


def test_a_bold_wrong_answer_costs_more_than_an_honest_one(tmp_path):
    truth = [[0, 0], [8, 8]]
    bold = score.score_values(truth, [0, 1], predictions(tmp_path / "a.csv", ["0,5,5,1,1", "1,8,8,1,1"]))
    honest = score.score_values(truth, [0, 1], predictions(tmp_path / "b.csv", ["0,5,5,4,4", "1,8,8,4,4"]))
    assert bold["median"] == honest["median"] and bold["nll"] > honest["nll"]


def test_predictions_without_sigma_have_errors_and_no_likelihood(tmp_path):
    found = score.score_values([[0, 0]], [0], predictions(tmp_path / "p.csv", ["0,3,4"], "frame,x_mm,y_mm"))
    assert found["median"] == 5 and math.isnan(found["nll"]) and math.isnan(found["inside_1"])


@pytest.mark.parametrize(
    ("lines", "head", "words"),
    [
        (["0,1,2,0,1"], "frame,x_mm,y_mm,sigma_x_mm,sigma_y_mm", ":2: sigma"),
        (["0,1,2"], "frame,x_m,y_m", ":1: columns"),
        (["0,1,2,3,3", "one,1,2,3,3"], "frame,x_mm,y_mm,sigma_x_mm,sigma_y_mm", ":3:"),
        (["0,1,2,3"], "frame,x_mm,y_mm,sigma_x_mm,sigma_y_mm", ":2: 4 cells, expected 5"),
    ],
)
def test_bad_predictions_are_refused_with_file_and_line(tmp_path, lines, head, words):
    with pytest.raises(score.ScoreError, match="p.csv" + words):
        predictions(tmp_path / "p.csv", lines, head)


def test_predictions_of_frames_that_are_not_judged_are_refused(tmp_path):
    with pytest.raises(score.ScoreError, match="frame 7"):
        score.score_values([[0, 0]], [0], predictions(tmp_path / "p.csv", ["7,1,1,1,1"]))


def test_patterns_count_misses_and_false_touches():
    truth = np.array([[1, 1, 0], [1, 0, 0], [0, 0, 1], [0, 0, 0]])
    found = score.score_points(truth, np.array([[1, 0, 0], [1, 0, 0], [0, 1, 1], [0, 1, 0]]))
    assert found["patterns"] == pytest.approx(1 / 3) and found["doubles"] == 0
    assert (found["misses"], found["false"], found["quiet_false"]) == (1, 1, 1)
    assert found["points"] == pytest.approx(7 / 9)


def test_the_tank_score_is_one_for_the_truth_and_less_for_nothing():
    truth = np.zeros((256, 256), np.uint8)
    truth[60:120, 60:120], truth[150:200, 100:180] = 1, 2
    assert score.score_labels(truth, truth) == pytest.approx(1)
    nothing, half = score.score_labels(truth, np.zeros_like(truth)), score.score_labels(truth, np.where(truth == 1, 1, 0))
    assert nothing < half < 1
    # Both masks empty: every mean and variance is 0, and the similarity 1.
    assert score.score_labels(np.zeros_like(truth), np.zeros_like(truth)) == pytest.approx(1)


def test_alarms_are_counted_as_runs_and_late_by_frames():
    found = score.score_alarms([70, 71, 72, 80, 101, 150, 300], 64, 400, [(100, 105), (150, 160)], grace=10)
    # 70 to 72 and 80 are two runs with four frames in total; 300 is after the last event and is not judged.
    assert (found["false"], found["false_frames"], found["delays"]) == (2, 4, [1, 0])
    assert math.isnan(score.score_alarms([], 64, 400, [(100, 105)])["delays"][0])


def test_splits_are_disjoint_and_the_same_every_time():
    first, second = splits.place("made/up", 2500), splits.place("made/up", 2500)
    assert first.keys() == second.keys() and all((first[part] == second[part]).all() for part in first)
    for part, rows in first.items():
        assert len(set(rows)) == len(rows)
        if part != "test":
            assert not set(rows) & set(first["test"]) and len(rows) == int(part.split(".")[0])
    assert not (splits.place("another", 2500)["test"] == first["test"]).all()


@pytest.mark.parametrize("path", sorted(splits.FOLDER.glob("*/*.csv")), ids=lambda path: path.stem)
def test_frozen_splits_are_disjoint(path):
    rows = list(csv.DictReader(path.open()))
    parts = {}
    for row in rows:
        parts.setdefault(row["part"], []).append(int(row["row"]))
    assert all(len(set(part)) == len(part) for part in parts.values())
    pairs = {"within": "within-test"} if "singles" in parts else {part: "test" for part in parts if part not in ("test", "old")}
    for part, test in pairs.items():
        assert not set(parts[part]) & set(parts[test]), f"{part} and {test} share rows"


def test_frozen_splits_are_what_the_stated_seed_gives():
    for path in sorted((splits.FOLDER / "place").glob("*.csv")):
        name = path.stem if path.stem == "hydrogel" else "/".join(path.stem.rsplit("-", 1))
        count = {"hydrogel": 500, "cam09/10": 2000, "cam09/15": 2000}.get(name, 2500)
        frozen, made = splits.read("place", name, count), splits.place(name, count)
        assert frozen.keys() == made.keys() and all((frozen[part] == made[part]).all() for part in made), name


def test_a_split_that_does_not_fit_the_data_is_refused():
    with pytest.raises(splits.SplitError, match="hydrogel.csv"):
        splits.read("place", "hydrogel", 100)


@pytest.mark.parametrize("module", [nearest, kernel_ridge, gaussian_process, gauss_newton], ids=lambda module: module.__name__)
def test_baselines_beat_the_mean_and_state_sigmas_that_hold(module):
    (frames, places), (judged, truth) = skin(150, 1), skin(200, 2)
    told = tasks.told("place", frames, places[:, :2])
    found, sigma = module.regress(told)(judged)
    guessed, _ = mean.regress(told)(judged)
    errors, plain = (np.linalg.norm(answer - truth[:, :2], axis=1) for answer in (found, guessed))
    assert np.median(errors) < 0.35 * np.median(plain)
    assert sigma.shape == found.shape and (sigma > 0).all()
    inside = (np.abs(found - truth[:, :2]) < sigma).mean()
    assert 0.5 < inside < 0.95, inside


def test_a_gaussian_process_is_less_sure_far_from_its_pokes():
    frames, places = skin(150, 1, noise=0.005)
    near = places[:, 0] < 0
    _, sigma = gaussian_process.regress(tasks.told("place", frames[near], places[near, :2]))(frames)
    assert np.median(sigma[places[:, 0] > 0.02]) > 1.5 * np.median(sigma[near])


def test_ten_pokes_are_enough_to_run_every_baseline():
    (frames, places), (judged, _) = skin(10, 3), skin(5, 4)
    for module in (mean, nearest, kernel_ridge, gaussian_process, gauss_newton):
        found, sigma = module.regress(tasks.told("place", frames, places[:, :2]))(judged)
        assert found.shape == (5, 2) and np.isfinite(found).all() and (sigma > 0).all()


def test_superposition_finds_doubles_from_singles():
    random = np.random.default_rng(5)
    responses = random.standard_normal((6, CHANNELS))
    singles = np.tile(np.eye(6), (4, 1))
    told = tasks.told("points", singles @ responses + 0.05 * random.standard_normal((24, CHANNELS)), singles)
    truth = np.array([[1, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 1], [0, 0, 0, 0, 0, 0]])
    found, _ = gauss_newton.regress(told)(truth @ responses)
    assert ((found > 0.5) == truth).all()


def test_the_disc_model_places_an_unlabelled_press():
    angles = 2 * np.pi * np.arange(16) / 16
    electrodes, identity = 0.08 * np.column_stack([np.cos(angles), np.sin(angles)]), np.eye(16)
    channels = [(k, (k + 8) % 16, m, (m + 1) % 16) for k in range(16) for m in range(16) if not {m, (m + 1) % 16} & {k, (k + 8) % 16}]
    a, b, plus, minus = np.array(channels).T
    drives, reads = identity[a] - identity[b], identity[plus] - identity[minus]
    from baselines import disc

    model = disc.voltages(electrodes / 0.08, drives, reads)
    truth = np.array([[0.3, -0.2], [-0.4, 0.1]])
    change = -0.01 * disc.sensitivities(truth, electrodes / 0.08, drives, reads).T
    random = np.random.default_rng(6)
    rest = np.tile(np.abs(model), (40, 1)) * (1 + 1e-4 * random.standard_normal((40, len(model))))
    told = SimpleNamespace(radius_m=0.08, electrodes_m=electrodes, drives=drives, reads=reads, rest=rest)
    found, sigma = gauss_newton_image.unlabelled(told)(np.abs(model + change), np.tile(np.abs(model), (2, 1)))
    assert (np.linalg.norm(found - 0.08 * truth, axis=1) < 0.012).all() and (sigma > 0).all()


def test_labels_that_belong_lag_or_are_of_other_frames_are_told_apart():
    frames, places = skin(300, 7)
    assert not labels.examine(frames, places)["is_bad"]
    for lag in (1, -2):
        found = labels.examine(frames, np.roll(places, lag, axis=0))
        assert found["is_bad"] and found["lag"] == lag, found
    assert "do not belong" in labels.examine(frames, places[np.random.default_rng(1).permutation(300)])["verdict"]
    assert "too few" in labels.examine(frames[:8], places[:8])["verdict"]


def test_a_mirror_is_told_by_an_earlier_session():
    old, (frames, places) = skin(300, 8), skin(200, 9)
    assert labels.mirrored(old, (frames, places))[0] is None
    assert labels.mirrored(old, (frames, places * [-1, 1, 1]))[0] == "x mirrored"
    assert labels.mirrored(old, (frames, places[:, [1, 0, 2]]))[0] == "x and y exchanged"


def matrix(name, values):
    """An array of doubles in MATLAB's version 5 format."""

    def element(kind, content):
        return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)

    parts = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", *values.shape)) + element(1, name.encode())
    return element(14, parts + element(9, values.astype("<f8").tobytes(order="F")))


@pytest.mark.parametrize("is_compressed", [False, True])
def test_matlab_files_are_read_and_broken_ones_refused(tmp_path, is_compressed):
    values = np.arange(6.0).reshape(2, 3)
    body = matrix("befores", values)
    if is_compressed:
        packed = zlib.compress(body)
        body = struct.pack("<II", 15, len(packed)) + packed
    whole = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + body
    (tmp_path / "a.mat").write_bytes(whole)
    assert (mat5.load(tmp_path / "a.mat")["befores"] == values).all()
    (tmp_path / "b.mat").write_bytes(whole[:-9])
    with pytest.raises(mat5.MatError):
        mat5.load(tmp_path / "b.mat")
    (tmp_path / "c.mat").write_bytes(b"no such file")
    with pytest.raises(mat5.MatError, match="version"):
        mat5.load(tmp_path / "c.mat")


def test_tables_with_text_gaps_or_nan_are_refused_with_the_line(tmp_path):
    for text, words in (("1,2\n3,x\n", ":2:"), ("1,2\n3\n", ":2: 1 values"), ("1,2\nnan,1\n", ":2: a value is not finite"), ("", "no row")):
        (tmp_path / "t.csv").write_text(text)
        with pytest.raises(data.DataError, match=words):
            data.table(tmp_path / "t.csv")


def program(name):
    loader = SourceFileLoader(name, str(HERE / name))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(name, loader))
    loader.exec_module(module)
    return module


def test_fetch_centres_positions_and_tells_a_wrong_file(tmp_path):
    fetch = program("fetch")
    assert fetch.centred(b"0.01,-0.4,0.018\n0.03,-0.2,0.0185\n") == b"x_m,y_m,depth_m\n-0.010000,-0.100000,0.018000\n0.010000,0.100000,0.018500\n"
    rows = fetch.listed()
    assert {"cam09", "five-skins", "six-points", "hydrogel", "hydrogel-damage", "ktc"} == set(rows)
    assert all(len(row[2]) == 64 and row[4].startswith("https://") for several in rows.values() for row in several)
    file = tmp_path / rows["cam09"][0][0]
    file.parent.mkdir(parents=True)
    file.write_text("1,2\n")
    assert not fetch.complete("cam09", rows["cam09"][:1], tmp_path, is_check=True)


def test_a_method_list_with_a_mistake_is_refused_with_the_line(tmp_path):
    (tmp_path / "methods.txt").write_text("# a method a line\nmine baselines.mean more\n")
    with pytest.raises(methods.MethodError, match="methods.txt:2"):
        methods.listed(tmp_path / "methods.txt")
    with pytest.raises(methods.MethodError, match="no function 'regres'"):
        methods.load("mine", "baselines.mean:regres")
    with pytest.raises(methods.MethodError, match="cannot be imported"):
        methods.load("mine", "no_such_module")


def test_a_stranger_enters_by_one_line_and_what_is_missing_is_said(tmp_path):
    write_skin(tmp_path / "data" / "cam09" / "new", 200, 10)
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n\n\ndef regress(told):\n    middle = np.median(told.targets, 0)\n"
        "    return lambda frames: (np.tile(middle, (len(frames), 1)), np.full((len(frames), told.targets.shape[1]), 0.02))\n"
    )
    done = subprocess.run(
        [sys.executable, str(HERE / "run"), "data", "--methods", "nearest-neighbour", "--method", "mine:regress", "--out", "out", "--jobs", "1",
         "--only", "place,depth,several", "--no-plots"],
        cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(tmp_path)}, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "several: skipped: its sets are not in data (six-points)" in done.stdout
    assert "no frozen split for cam09/new" in done.stdout
    results = (tmp_path / "out" / "RESULTS.md").read_text()
    assert "| mine.regress | " in results and "nearest-neighbour" in results
    # The nearest neighbours do better than the median place.
    lines = [line.split("|") for line in results.splitlines() if line.startswith("| 50 |")]
    medians = {line[2].strip(): float(line[4]) for line in lines}
    assert medians["nearest-neighbour"] < 0.7 * medians["mine.regress"]
    again = subprocess.run([sys.executable, str(HERE / "score.py"), "--data", "data", "out/predictions"], cwd=tmp_path, capture_output=True, text=True)
    assert again.returncode == 0 and "mine.regress" in again.stdout, again.stderr


def test_a_method_that_fails_is_said_and_the_others_go_on(tmp_path):
    write_skin(tmp_path / "data" / "cam09" / "new", 100, 11)
    (tmp_path / "broken.py").write_text("def regress(told):\n    raise RuntimeError('out of luck')\n")
    done = subprocess.run(
        [sys.executable, str(HERE / "run"), "data", "--methods", "mean", "--method", "broken:regress", "--out", "out", "--jobs", "1",
         "--only", "place", "--no-plots"],
        cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(tmp_path)}, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1 and "out of luck" in done.stderr and "| mean |" in done.stdout


def test_rules_are_kept_and_bad_answers_and_files_are_said(tmp_path):
    frames, places = skin(60, 13)
    told = tasks.told("place", frames, places[:, :2])
    case = tasks.Case("place", "made/up", "60", "60.1", "place", told, frames, np.arange(60), places[:, :2] * 1000)

    def entry(answer):
        return SimpleNamespace(name="m", regress=lambda told: answer)

    spread = np.full((60, 2), 0.01)
    with pytest.raises(tasks.RuleError, match="other frames"):
        tasks.predict(entry(lambda frames: (frames[:, :2] - frames[:, :2].mean(0), spread[: len(frames)])), case, tmp_path)
    with pytest.raises(tasks.RuleError, match="expected"):
        tasks.predict(entry(lambda frames: (frames[:, :3], spread)), case, tmp_path)
    tasks.predict(entry(lambda frames: (frames[:, :2], -spread[: len(frames)])), case, tmp_path / "m")
    failures = []
    assert score.score_all([case], tmp_path, ["m"], failures) == [] and "sigma" in failures[0]
    folder = tmp_path / "data" / "cam09" / "bad"
    write_skin(folder, 60)
    with (folder / "differences.csv").open("a") as file:
        file.write("1,2\n")
    done = subprocess.run(
        [sys.executable, str(HERE / "run"), "data", "--methods", "mean", "--only", "place", "--out", "out", "--jobs", "1", "--no-plots"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1 and "differences.csv:61: 2 values" in done.stderr and "Traceback" not in done.stderr


def test_check_tells_lagging_labels_and_an_empty_folder(tmp_path):
    frames, places = skin(120, 12)
    np.savetxt(tmp_path / "f.csv", frames, delimiter=",")
    np.savetxt(tmp_path / "p.csv", np.roll(places, 1, axis=0), delimiter=",", header="x_m,y_m,depth_m", comments="")
    run = [sys.executable, str(HERE / "check")]
    plain = {**os.environ, "PATH": "", "DERMIS": ""}
    done = subprocess.run([*run, "--frames", "f.csv", "--positions", "p.csv"], cwd=tmp_path, capture_output=True, text=True, env=plain)
    assert done.returncode == 1 and "labels lag by 1 row" in done.stdout, done.stderr
    done = subprocess.run([*run, "."], cwd=tmp_path, capture_output=True, text=True, env=plain)
    assert done.returncode == 1 and "no pressed skin" in done.stderr


def test_the_marked_part_of_a_page_is_replaced_alone(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{report.MARKS[0]}\nold\n{report.MARKS[1]}\nafter\n")
    report.between_marks(page, "new")
    assert page.read_text() == f"before\n{report.MARKS[0]}\n\nnew\n{report.MARKS[1]}\nafter\n"
    page.write_text("no marks")
    with pytest.raises(ValueError, match="no lines"):
        report.between_marks(page, "new")


def test_short_tables_keep_the_best_plain_method_of_each_group():
    head = ["pokes", "method", "median"]
    lines = [["10", "mean", "1,200"], ["10", "near", "9 %"], ["10", "mine", "none"], ["50", "mean", "-"], ["50", "near", "0.5 (0 to 1)"]]
    assert report.best_plain(head, lines, {"mean", "near"}, "median") == [lines[1], lines[2], lines[4]]
    assert report.best_plain(head, lines, {"mean", "near"}, "median", max) == [lines[0], lines[2], lines[4]]
    assert report.best_plain(head, lines, (), "median") == lines


def test_short_tables_leave_out_tasks_that_only_plain_methods_entered():
    row = {"set": "s", "size": "15", "median": 1.0, "p90": 2.0, "rms": 1.0, "inside_1": 0.7, "inside_2.5": 1.0, "nll": 1.0, "misses": 0,
           "false": 0, "frames": 10}  # fmt: skip
    rows = [row | {"task": task, "method": method} for task, method in (("session", "mean"), ("unlabelled", "mean"), ("unlabelled", "mine"))]
    assert "New session" in report.tables(rows, {}, is_full=False)
    short = report.tables(rows, {}, is_full=False, plain={"mean"})
    assert "New session" not in short and "| mean |" in short and "| mine |" in short
