"""The ten lines that introduce the package, word for word, and the shapes and types that they promise."""

import subprocess
import sys

import numpy as np
import pytest

import dermis


def test_the_script(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record = ["record", "healing-square", "--speed", "0", "--frames", "150", "--out", "press.mcap"]
    subprocess.run([sys.executable, "-m", "dermis", *record], check=True)
    skin = dermis.Skin("healing-square")              # a name, a path, or TOML text; skin.to_toml(), skin.name, skin.outline
    model = skin.model()                              # model.nodes (n,2|3), .elements (m,3|4), .electrodes, .channels (k,4), .grid
    v = model.voltages()                              # (k,) volts at model.sigma (m,), the file's own; voltages(sigma) at another
    sigma = 1.1 * model.sigma
    J = model.jacobian(sigma)                         # (k, m), EIDORS' sign and units
    sigmas = np.stack([model.sigma, sigma])
    V = model.voltages_many(sigmas, threads=2)        # (n, k)
    k, m, n = len(v), len(model.sigma), len(sigmas)
    assert v.shape == (k,) and J.shape == (k, m) and V.shape == (n, k) and k == 208
    assert model.nodes.shape[1] == 2 and model.elements.shape == (m, 3)
    assert model.channels.shape == (k, 4) and len(model.electrodes) == 16
    np.testing.assert_array_equal(V[1], model.voltages(sigma))
    twin = dermis.Twin(skin, seed=1); twin.press(x_mm=10, y_mm=-5, radius_mm=8, force_n=2.0); frame = twin.step()
    pipe = dermis.Pipeline(skin); result = pipe.process(frame)          # a frame or an array (k,); result.image, .touches, .damage, .health, .time_s
    rows, columns = model.grid.shape
    assert result.image.shape == (rows, columns) and result.image.dtype == np.float32
    assert len(result.touches) == 0 and result.time_s == 0.0 and result.health["sound"]
    seen = 0
    for result in dermis.open("twin:healing-square", frames=100):    # or tcp:, serial:, file.mcap; a context manager; .asnumpy()
        seen += 1
    assert seen == 100
    rec = dermis.Recording("press.mcap"); frames = rec.frames()                  # .touches() as a structured array
    assert frames.shape == (150, k) and rec.frames_written == 150
    assert {"id", "phase", "x_mm", "y_mm"} <= set(rec.touches().dtype.names)
    image = model.image(frames[:30], frames[30:35])  # (n, rows, columns) float32, NaN outside; prior=, hyperparameter=
    assert image.shape == (5, rows, columns) and image.dtype == np.float32
    assert np.isnan(image[0][~model.grid.inside]).all() and np.isfinite(image[0][model.grid.inside]).all()
    maps = dermis.design(skin, places=8)                                          # maps.position_bound_mm (rows, columns), ...
    assert maps.position_bound_mm.ndim == 2 and np.nanmin(maps.position_bound_mm) > 0


def test_calibrate(skin, tmp_path):
    places = [(x, y) for x in (-25.0, 0.0, 25.0) for y in (-25.0, 0.0, 25.0)]
    baselines, frames = [], []
    twin = dermis.Twin(skin, seed=3)
    for x, y in places:
        twin.release()
        for _ in range(30):
            rest = twin.step()
        twin.press(x, y, radius_mm=8)
        for _ in range(30):
            pressed = twin.step()
        baselines.append(rest.values)
        frames.append(pressed.values)
    positions_m = 1e-3 * np.array(places)
    cal = dermis.calibrate(skin, baselines, frames, positions_m)        # cal.leave_one_out_mm, cal.save(path)
    path = tmp_path / "c.json"
    cal.save(path)
    assert 0.0 < cal.leave_one_out_mm < 50.0 and cal.pokes == 9
    again = dermis.Calibration.load(path)
    assert again.leave_one_out_mm == cal.leave_one_out_mm
    dermis.Pipeline(skin, calibration=again)
    with pytest.raises(dermis.InputError, match="ionic-disc"):
        dermis.Pipeline("ionic-disc", calibration=path)


def test_touches_have_their_fields(skin, pressed):
    pipe = dermis.Pipeline(skin)
    rest, press = pressed
    for frame in rest:
        result = pipe.process(frame)
    assert pipe.ready and len(result.touches) == 0
    for frame in press:
        result = pipe.process(frame)
    names = (
        *("id", "phase", "x_mm", "y_mm", "force_n", "amplitude", "area_mm2", "sigma_x_mm", "sigma_y_mm", "radius_mm"),
        *("other_x_mm", "other_y_mm", "other_probability"),
    )
    assert result.touches.dtype.names == names and result.touches.dtype == dermis.touch_dtype
    (touch,) = result.touches
    assert touch.phase == "move" and touch.id == 1
    # Within a tenth of the skin's side.
    assert abs(touch.x_mm - 10) < 10 and abs(touch.y_mm + 5) < 10
    assert result.touches["id"].tolist() == [1]
    # Arrays are processed like frames.
    again = dermis.Pipeline(skin)
    for frame in rest + press:
        plain = again.process(frame.values, time_s=frame.time_s)
    np.testing.assert_array_equal(plain.image, result.image)
    assert plain.touches.x_mm == result.touches.x_mm


def test_skins_travel(skin, tmp_path):
    import copy
    import pickle

    path = tmp_path / "mine.toml"
    path.write_text(skin.to_toml())
    assert dermis.Skin(str(path)) == dermis.Skin(path) == dermis.Skin(skin.to_toml()) == skin
    assert pickle.loads(pickle.dumps(skin)) == skin == copy.deepcopy(skin) and hash(skin) == hash(copy.copy(skin))
    assert "ionic-disc" in dermis.Skin.names()
    np.testing.assert_allclose(skin.outline.min(axis=0), skin.bounds_m[0])
    assert skin._repr_svg_().startswith("<svg")


def test_a_twin_repeats_itself(skin):
    def values(seed):
        twin = dermis.Twin(skin, seed=seed)
        twin.press(0, 0)
        return np.stack([twin.step().values for _ in range(5)])

    np.testing.assert_array_equal(values(4), values(4))
    assert (values(4) != values(5)).any()


@pytest.mark.parametrize("name", dermis.Skin.names())
def test_every_built_in_skin(name):
    skin = dermis.Skin(name)
    assert skin.channel_count > 0 and repr(skin).startswith("<dermis.Skin")
    assert skin.outline.shape[1] == 2 and skin.electrode_count > 0


def test_models_of_coils_are_read_at_rest_only():
    model = dermis.Skin("em-8").model()
    assert len(model.voltages()) == model.skin.channel_count
    assert model.pixel_jacobian.shape[0] == model.skin.channel_count
    with pytest.raises(dermis.InputError, match="electrodes"):
        model.voltages(model.sigma)


def test_a_circuit_is_part_of_the_model():
    """Skins loaded by their instrument: voltages at the file's own conductivity equal the pipeline's."""
    model = dermis.Skin("piezo-square").model(elements=1500)
    np.testing.assert_allclose(model.voltages(model.sigma), model.voltages(), rtol=1e-12)
