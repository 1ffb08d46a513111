"""Commercial boards, each replaced by a stand-in with the same interface."""

import importlib.util
from pathlib import Path

import dermis
import numpy as np

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Cn0565:
    """The interface of pyadi-iio's ``adi.cn0565``: settings, the sequence f+, s+, s-, f-, and readings as (real,
    imaginary)."""

    electrode_count, force_distance, sense_distance = 8, 1, 1
    readings = None

    @property
    def switch_sequence(self):
        count, rows = self.electrode_count, []
        for f_plus in range(count):
            f_minus = (f_plus + self.force_distance) % count
            for s_plus in range(count):
                s_minus = (s_plus + self.sense_distance) % count
                if not {s_plus, s_minus} & {f_plus, f_minus}:
                    rows.append((f_plus, s_plus, s_minus, f_minus))
        return np.array(rows)

    @property
    def all_voltages(self):
        if len(self.readings) == 0:
            raise StopIteration
        now = self.readings.pop(0)
        return np.column_stack([now.real, now.imag])


def test_cn0565_finds_an_object_where_it_is():
    board = Cn0565()
    cn0565 = example("cn0565")
    skin = cn0565.skin_of(board)
    model = skin.model(elements=2500)
    rest = model.voltages()
    # A 30 mm insulator at (50, 20) mm, behind an instrument with its own gain and phase.
    centroids = np.asarray(model.nodes)[np.asarray(model.elements)].mean(axis=1)[:, :2]
    sigma = np.where(np.hypot(*(centroids - [0.05, 0.02]).T) < 0.015, 0.05, 1.0) * model.sigma
    phase = 37.0 * np.exp(0.4j)
    noise = np.random.default_rng(0)
    noisy = lambda volts: phase * (volts + 2e-5 * np.abs(rest).max() * noise.standard_normal(len(volts)))
    board.readings = [noisy(rest) for _ in range(40)] + [noisy(model.voltages(sigma)) for _ in range(10)]

    def taken():
        while board.readings:
            yield next(stream)

    stream = cn0565.frames(board)
    results = list(dermis.open(taken(), skin))
    assert len(results) == 50
    touches = results[-1].touches
    assert len(touches) == 1
    assert np.hypot(touches["x_mm"][0] - 50.0, touches["y_mm"][0] - 20.0) < 12.0
