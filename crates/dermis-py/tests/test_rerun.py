"""Sessions and recordings in Rerun: files that its own tools read back, and invalid input."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dermis

rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed")
reader = pytest.importorskip("rerun.chunk", reason="this rerun-sdk has no reader of chunks")

from dermis.errors import FileError, InputError
from dermis.rerun import SkinLog, log, save


@pytest.fixture(scope="module")
def pressed():
    """Results of a liquid disc: learning, at rest, pressed."""
    skin = dermis.Skin("ionic-disc")
    twin, pipe = dermis.Twin(skin, seed=1, fade_s=0), dermis.Pipeline(skin)
    results = [pipe.process(twin.step()) for _ in range(40)]
    twin.press(20, -30, radius_mm=10, force_n=0.5)
    results += [pipe.process(twin.step()) for _ in range(10)]
    return skin, results


def cells(path, entity, part):
    """A component of an entity in a file, from Rerun's own reader: one value per frame, in order of frames."""
    rows = []
    for chunk in reader.RrdReader(str(path)).stream():
        if chunk.entity_path != f"/{entity}":
            continue
        chunk = chunk.to_record_batch()
        for name in chunk.schema.names:
            if name.endswith(f":{part}"):
                values = chunk.column(name).to_pylist()
                frames = chunk.column("frame").to_pylist() if "frame" in chunk.schema.names else [0] * len(values)
                rows += zip(frames, values)
    return [value for _, value in sorted(rows, key=lambda row: row[0]) if value is not None]


def timelines(path, entity):
    """The timelines of an entity, each in order of frames, as whole numbers."""
    found = {}
    for chunk in reader.RrdReader(str(path)).stream():
        if chunk.entity_path == f"/{entity}" and not chunk.is_static:
            batch = chunk.to_record_batch()
            for name in chunk.timeline_names:
                found.setdefault(name, []).append(batch.column(name).to_numpy(zero_copy_only=False).astype(np.int64))
    joined = {name: np.concatenate(parts) for name, parts in found.items()}
    order = np.argsort(joined["frame"], kind="stable")
    return {name: values[order] for name, values in joined.items()}


def test_a_file_holds_the_results(pressed, tmp_path):
    skin, results = pressed
    path = tmp_path / "press.rrd"
    assert save(results, path, skin=skin) == len(results)
    assert list(tmp_path.iterdir()) == [path]
    last = results[-1]
    (touch,) = last.touches

    colours = cells(path, "skin/surface", "vertex_colors")
    assert len(colours) == sum(result.ready for result in results)
    # The mesh is logged once.
    (vertices,), (triangles,) = (cells(path, "skin/surface", part) for part in ("vertex_positions", "triangle_indices"))
    assert len(colours[-1]) == len(vertices)
    vertices, triangles = np.array(vertices), np.array(triangles)
    assert triangles.max() == len(vertices) - 1 and len(triangles) == 2 * np.isfinite(last.image).sum()
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = 0.5 * np.cross(b - a, c - a)[:, 2]
    # Counter-clockwise as seen from outside; pixels on the rim are cut off there.
    assert area.min() > -1e-9 and area.sum() == pytest.approx(np.pi * 0.087**2, rel=0.03)
    assert np.hypot(*vertices[:, :2].T).max() < 0.0871
    # The image is positive at a touch, so red, and strongest there.
    red, green = (np.array(colours[-1]) >> shift & 255 for shift in (24, 16))
    strongest = np.argmin(green)
    assert red[strongest] > green[strongest] + 50
    assert np.hypot(*(1e3 * vertices[strongest, :2] - [touch.x_mm, touch.y_mm])) < 10

    positions = cells(path, "skin/touches", "positions")
    assert positions[0] == [] and len(positions) == len(colours)
    np.testing.assert_allclose(positions[-1], [[1e-3 * touch.x_mm, 1e-3 * touch.y_mm, 0]], atol=1e-7)
    sigma = cells(path, "skin/sigma", "half_sizes")[-1]
    np.testing.assert_allclose(np.array(sigma)[0, :2], [1e-3 * touch.sigma_x_mm, 1e-3 * touch.sigma_y_mm], rtol=1e-5)
    vector, origin = (np.array(cells(path, "skin/forces", part)[-1][0]) for part in ("vectors", "origins"))
    np.testing.assert_allclose(vector, [0, 0, -0.01 * touch.force_n], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(origin + vector, positions[-1][0], atol=1e-7)
    forces = cells(path, "skin/plots/force_n", "scalars")
    assert forces[-1] == [pytest.approx(touch.force_n)] and forces[0] == [0.0]
    said = [text for (text,) in cells(path, "skin/health", "text")]
    assert said == ["learning the baseline", "sound"]


def test_times_are_those_of_the_recording(tmp_path):
    recorded = tmp_path / "press.mcap"
    command = [sys.executable, "-m", "dermis", "record", "healing-square", "--speed", "0", "--frames", "80", "--out", recorded]
    subprocess.run(command, check=True, capture_output=True)
    recording = dermis.Recording(recorded)
    times_s, wall_ns, sequences = recording.times()
    for name, source in (("a", recording), ("b", recorded), ("c", dermis.open(recorded))):
        path = tmp_path / f"{name}.rrd"
        assert save(source, path) == 80
        found = timelines(path, "skin/plots/left_out")
        assert sorted(found) == ["frame", "time", "wall"]
        np.testing.assert_array_equal(found["frame"], sequences)
        np.testing.assert_array_equal(found["wall"], wall_ns)
        seconds = 1e-9 * found["time"]
        np.testing.assert_allclose(seconds - seconds[0], times_s - times_s[0], atol=1e-6)


def test_the_rerun_command_finds_no_fault(pressed, tmp_path):
    command = shutil.which("rerun", path=str(Path(sys.executable).parent))
    if command is None:
        pytest.skip("the command rerun is not installed")
    skin, results = pressed
    save(results, tmp_path / "press.rrd", skin=skin, entity="robot/palm")
    run = subprocess.run([command, "rrd", "verify", tmp_path / "press.rrd"], capture_output=True, text=True)
    assert run.returncode == 0 and "without error" in run.stdout + run.stderr
    run = subprocess.run([command, "rrd", "print", tmp_path / "press.rrd"], capture_output=True, text=True)
    # The layout comes with the file.
    assert "/robot/palm/surface" in run.stdout and "ViewBlueprint" in run.stdout


def test_a_bent_skin_in_the_robots_frame(tmp_path):
    skin = dermis.Skin("piezo-cylinder")
    twin, pipe = dermis.Twin(skin, seed=1, fade_s=0), dermis.Pipeline(skin)
    results = [pipe.process(twin.step()) for _ in range(34)]
    mount = np.eye(4)
    mount[:3, 3] = [0.1, 0.2, 0.3]
    save(results, tmp_path / "bent.rrd", skin=skin, root_from_patch=mount)
    vertices = np.array(cells(tmp_path / "bent.rrd", "skin/surface", "vertex_positions")[-1])
    np.testing.assert_allclose(np.hypot(vertices[:, 0], vertices[:, 2] + 0.095), 0.095, atol=1e-6)
    moved = cells(tmp_path / "bent.rrd", "skin", "translation")
    np.testing.assert_allclose(moved[-1][0], [0.1, 0.2, 0.3], atol=1e-7)


def test_a_given_scale_is_kept(pressed, tmp_path):
    skin, results = pressed
    save(results, tmp_path / "own.rrd", skin=skin, full_scale=0.5)
    scales = cells(tmp_path / "own.rrd", "skin/plots/scale", "scalars")
    assert {scale for (scale,) in scales} == {0.5}
    save(results, tmp_path / "found.rrd", skin=skin)
    scales = [scale for (scale,) in cells(tmp_path / "found.rrd", "skin/plots/scale", "scalars")]
    assert scales == sorted(scales) and scales[-1] > scales[0]


def test_health_has_one_line_per_change(tmp_path):
    skin = dermis.Skin("healing-square")
    twin, pipe = dermis.Twin(skin, seed=1), dermis.Pipeline(skin)
    frames = [twin.step().values for _ in range(120)]
    for values in frames[50:]:
        values[7] = np.nan
    results = [pipe.process(values, time_s=n / 25) for n, values in enumerate(frames)]
    save(results, tmp_path / "broken.rrd", skin=skin)
    said = [text for (text,) in cells(tmp_path / "broken.rrd", "skin/health", "text")]
    assert said[:2] == ["learning the baseline", "sound"] and "7 " in said[2] and len(said) < 6
    left_out = cells(tmp_path / "broken.rrd", "skin/plots/left_out", "scalars")
    assert left_out[0] == [0.0] and left_out[-1] == [1.0]


def test_results_go_to_a_stream_one_by_one(pressed):
    skin, results = pressed
    stream = rerun.RecordingStream("test")
    memory = stream.memory_recording()
    logger = SkinLog(skin, stream)
    for result in results[-3:]:
        logger.log(result)
    assert log(iter(results[-4:]), stream, skin=skin, frames=2) == 2
    stream.flush()
    assert memory.num_msgs() > 0


def test_bad_input_is_named(pressed, tmp_path):
    skin, results = pressed
    path = tmp_path / "x.rrd"
    for options, words in [
        ({"skin": None}, "skin: expected the skin of these results"),
        ({"entity": "/"}, "entity = '/': expected a path"),
        ({"full_scale": 0.0}, "full_scale = 0.0: expected a number above 0"),
        ({"mm_per_n": np.nan}, "mm_per_n = nan"),
        ({"frames": -1}, "frames = -1"),
        ({"root_from_patch": np.eye(3)}, r"root_from_patch: expected finite numbers of shape \(4, 4\), got shape \(3, 3\)"),
        ({"root_from_patch": 2 * np.eye(4)}, "root_from_patch: expected a rotation"),
    ]:
        with pytest.raises(InputError, match=words):
            save(results, path, **{"skin": skin, **options})
    with pytest.raises(InputError, match="source: expected a dermis.Session.*got int"):
        save(3, path)
    with pytest.raises(InputError, match="result: expected a dermis.Result, got int"):
        save([3], path, skin=skin)
    with pytest.raises(InputError, match="stream: expected a rerun.RecordingStream, got str"):
        log(results, "viewer", skin=skin)
    with pytest.raises(FileError, match="expected a file in an existing folder"):
        save(results, tmp_path / "none" / "x.rrd", skin=skin)
    with pytest.raises(dermis.FileError, match="none.mcap"):
        save(tmp_path / "none.mcap", path)
    # A failure leaves no file.
    assert list(tmp_path.iterdir()) == []
