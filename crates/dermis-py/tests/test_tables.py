"""Drawings, displays in notebooks, tables of other packages, and the bundled command."""

import subprocess
import sys

import numpy as np
import pytest

import dermis


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "press.mcap"
    command = [sys.executable, "-m", "dermis", "record", "healing-square", "--speed", "0", "--frames", "150", "--out", path]
    subprocess.run(command, check=True, capture_output=True)
    return dermis.Recording(path)


def test_recorded_frames(recording):
    frames = recording.frames()
    assert frames.shape == (150, 208) and np.isfinite(frames).all()
    np.testing.assert_array_equal(recording.frames(10, 20), frames[10:20])
    times_s, wall_ns, sequences = recording.times()
    assert times_s[0] == 0 and (np.diff(times_s) > 0).all() and (np.diff(sequences) == 1).all() and len(wall_ns) == 150
    touches = recording.touches()
    assert len(touches) and set(touches.phase) <= {"begin", "move", "end"} and (np.abs(touches.x_mm) < 60).all()
    assert recording.baselines() and isinstance(recording.events(), list)
    # Results of the same frames in a pipeline.
    replayed = [len(result.touches) for result in dermis.open(str(recording.path))]
    assert len(replayed) == 150 and sum(replayed) == len(touches)


def test_pandas(recording):
    pytest.importorskip("pandas")
    table = recording.to_pandas()
    assert table.shape == (150, 209) and list(table.columns[1:]) == recording.channel_labels
    np.testing.assert_array_equal(table.to_numpy()[:, 1:], recording.frames())


def test_arrow(recording):
    pytest.importorskip("pyarrow")
    assert recording.to_arrow().num_rows == 150


def test_xarray(recording):
    pytest.importorskip("xarray")
    table = recording.to_xarray()
    assert table.dims == ("time_s", "channel") and table.shape == (150, 208)


def test_drawings(skin, pressed):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    axes = skin.plot()
    assert {text.get_text() for text in axes.texts} >= {str(number) for number in range(1, 17)}
    pipe = dermis.Pipeline(skin)
    rest, press = pressed
    for frame in rest + press:
        result = pipe.process(frame)
    drawn = result.plot()
    assert drawn.images and len(drawn.figure.axes) == 2
    assert dermis.design(skin, places=8).plot().images


def test_displays_in_notebooks(skin, pressed):
    from xml.etree import ElementTree

    assert ElementTree.fromstring(skin._repr_svg_()).tag.endswith("svg")
    result = dermis.Pipeline(skin).process(pressed[0][0])
    assert "<table>" in result._repr_html_()


def test_sessions_as_arrays():
    times_s, readings, images = dermis.open("twin:healing-square", frames=40).asnumpy()
    assert times_s.shape == (40,) and readings.shape == (40, 208) and images.shape == (40, 64, 64)
    # The baseline takes 32 frames.
    assert np.isnan(images[0]).all() and np.isfinite(images[-1]).any()


def test_orders(skin, model):
    voltages = model.voltages()
    found = dermis.find_order(skin, voltages)
    assert found.is_stated and found.is_clear and found.correlation > 0.999
    found = dermis.find_order(model, np.stack([-voltages] * 3))
    assert found.is_clear and not found.is_stated and (found.sign == -1).all() and found.correlation > 0.999
    np.testing.assert_array_equal(found.to_skin(-voltages), voltages)
    with pytest.raises(dermis.InputError, match="frames"):
        found.to_skin(np.ones(3))


def test_measurement_major_layouts_are_found_and_shuffles_are_not(skin, model):
    voltages = model.voltages()
    columns = voltages.reshape(16, 13).T.ravel()
    found = dermis.find_order(skin, columns)
    assert found.is_clear and "by columns" in found.description and "channels = [" in found.lines
    np.testing.assert_allclose(found.to_skin(columns), voltages, rtol=1e-9)
    shuffled = np.random.default_rng(1).permutation(voltages)
    found = dermis.find_order(skin, shuffled)
    assert not found.is_clear and found.verdict.startswith("nothing fits")
    with pytest.raises(dermis.InputError, match="nothing fits"):
        found.to_skin(shuffled)


def test_conductances_in_siemens(skin):
    sheet_s = 1.3 * skin.model().sigma[0]
    finer = skin.model(elements=6000)
    found = dermis.conductance(skin, finer.voltages(np.full(len(finer.sigma), sheet_s)))
    assert abs(found.sheet_s / sheet_s - 1.0) < 0.02
    assert found.image_s.shape == found.sigma_s.shape and np.nanmin(found.sigma_s) > 0.0


def test_custom_sources(skin, model):
    rest = model.voltages()
    taken = list(dermis.open([rest] * 40, skin))
    assert len(taken) == 40 and taken[-1].ready
    with dermis.open(((0.02 * k, rest) for k in range(5)), skin) as session:
        assert [round(result.time_s, 6) for result in session] == [0.0, 0.02, 0.04, 0.06, 0.08]
    count = iter(range(6))

    def driver():
        k = next(count)
        return None if k % 2 else rest

    assert len(list(dermis.open(driver, skin))) == 3
    with pytest.raises(dermis.SourceError, match="expected 208 readings"):
        list(dermis.open([np.ones(7)], skin))
    with pytest.raises(dermis.InputError, match="skin"):
        dermis.open([rest])

    def broken():
        raise RuntimeError("the cable")
        yield

    with pytest.raises(dermis.SourceError, match="the cable"):
        list(dermis.open(broken(), skin))


def test_the_bundled_command():
    run = lambda *arguments: subprocess.run([sys.executable, "-m", "dermis", *arguments], capture_output=True, text=True)
    listed = run("skins", "list")
    assert listed.returncode == 0 and "healing-square" in listed.stdout
    refused = run("skins", "show", "no-such-skin")
    assert refused.returncode == 2 and "no-such-skin" in refused.stderr
    assert run("--no-such-option").returncode == 2
    assert run("--help").returncode == 0


def test_importing_loads_no_heavy_package():
    code = (
        "import sys, time; import numpy; begun = time.perf_counter(); import dermis; "
        "took = time.perf_counter() - begun; "
        "heavy = {'torch', 'jax', 'ray', 'matplotlib', 'pandas', 'pyarrow', 'xarray', 'scipy', 'meshio', 'tqdm'}; "
        "print(took, *sorted(heavy & set(sys.modules)))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert len(said) == 1, said
    print(f"import dermis after NumPy: {1e3 * float(said[0]):.0f} ms")


def test_everything_public_is_documented():
    lacking = []
    for name in dermis.__all__:
        value = getattr(dermis, name)
        if name in ("__version__", "touch_dtype"):
            continue
        if not value.__doc__:
            lacking.append(name)
        if isinstance(value, type) and value.__module__ == "dermis":
            lacking += [f"{name}.{member}" for member, of in vars(value).items() if not member.startswith("_") and not of.__doc__]
    assert not lacking, lacking
