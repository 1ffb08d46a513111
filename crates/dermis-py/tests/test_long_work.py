"""Long work: tqdm shows its progress, Ctrl-C ends it, and interrupted work leaves nothing behind."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import dermis


def many_pokes(skin, count):
    """A calibration that takes long: random frames at random places."""
    random = np.random.default_rng(1)
    baseline = skin.model().voltages()
    frames = baseline * (1.0 + 1e-3 * random.standard_normal((count, len(baseline))))
    low, high = skin.bounds_m
    return baseline, frames, random.uniform(0.6 * np.array(low), 0.6 * np.array(high), (count, 2))


def voltages_many(skin, folder):
    model = skin.model()
    sigmas = np.tile(model.sigma, (20000, 1))
    return lambda: model.voltages_many(sigmas)


def voltages_many_of_a_large_mesh(skin, folder):
    """A single row takes long."""
    from test_eit import square

    from dermis import eit

    nodes, elements, _ = square(300)
    model = eit.ForwardModel(eit.Mesh(nodes, elements), eit.points([0, 299, 89999, 89700]), eit.Protocol.generate(4, keep_driven=True))
    sigmas = np.broadcast_to(np.ones(len(elements)), (60, len(elements)))
    return lambda: model.voltages_many(sigmas)


def grid_of_many_pixels(skin, folder):
    from test_eit import square

    from dermis import eit

    mesh = eit.Mesh(*square(60)[:2])
    return lambda: [mesh.grid(4000) for _ in range(10)]


def operator_of_many_unknowns(skin, folder):
    from dermis import eit

    jacobian = np.random.default_rng(1).standard_normal((4000, 4000))
    return lambda: eit.Operator(jacobian, eit.Prior.noser(), 1e-2)


def forward_model_of_a_large_mesh(skin, folder):
    from test_eit import square

    from dermis import eit

    mesh = eit.Mesh(*square(400)[:2])
    protocol = eit.Protocol.generate(4, keep_driven=True)
    return lambda: [eit.ForwardModel(mesh, eit.points([0, 399, 159999, 159600]), protocol) for _ in range(20)]


def calibrate(skin, folder):
    model, pokes = skin.model(), many_pokes(skin, 1500)
    return lambda: [dermis.calibrate(model, *pokes) for _ in range(20)]


def design(skin, folder):
    model = skin.model()
    return lambda: [dermis.design(model, places=128) for _ in range(20)]


def tolerances(skin, folder):
    return lambda: dermis._dermis.tolerance_rows(skin, samples=1000)


def shards(skin, folder):
    from dermis._dermis import create_train_set, write_shard

    missing = create_train_set(skin, folder, 4000, shard_samples=400)
    return lambda: [write_shard(skin, folder, shard, 4000, shard_samples=400) for shard in missing]


def images(skin, folder):
    model = skin.model()
    baseline = model.voltages()
    frames = np.tile(baseline, (20000, 1))
    return lambda: [model.image(baseline, frames) for _ in range(20)]


LONG = [
    voltages_many,
    voltages_many_of_a_large_mesh,
    grid_of_many_pixels,
    operator_of_many_unknowns,
    forward_model_of_a_large_mesh,
    calibrate,
    design,
    tolerances,
    shards,
    images,
]


# Processes started in a shell's background ignore Ctrl-C, and so do their children.
LISTEN = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
CHILD = LISTEN + """
import sys, tempfile
import dermis, test_long_work
work = getattr(test_long_work, sys.argv[1])(dermis.Skin("healing-square"), tempfile.mkdtemp(dir=sys.argv[2]))
print("begun", flush=True)
try:
    work()
except KeyboardInterrupt:
    # The interrupted work may continue in the background, but holds no lock.
    assert dermis.Skin("em-8").channel_count == 28
    print("interrupted", flush=True)
"""


def after_ctrl_c(child):
    """Output of a process that is interrupted; one that keeps running is killed."""
    child.send_signal(signal.SIGINT)
    try:
        return child.communicate(timeout=120)
    finally:
        child.kill()


@pytest.mark.parametrize("work", LONG, ids=lambda work: work.__name__)
def test_ctrl_c_ends(work, tmp_path):
    """The signal arrives during the work, and the exception doesn't wait for its end. Runs in a separate process,
    whose end also ends the abandoned work."""
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, work.__name__, str(tmp_path)], cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "begun\n"
    time.sleep(0.5)
    said, _ = after_ctrl_c(child)
    assert said == "interrupted\n" and child.returncode == 0


def test_interrupted_shards_are_not_there(skin, tmp_path):
    """A process interrupted in the middle of a shard leaves complete ones in place."""
    code = LISTEN + (
        "import sys; from dermis._dermis import create_train_set, write_shard; folder = sys.argv[1]\n"
        "for shard in create_train_set('healing-square', folder, 4000, shard_samples=400):\n"
        "    print(shard, flush=True)\n"
        "    write_shard('healing-square', folder, shard, 4000, shard_samples=400)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "set")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "0\n"
    _, said = after_ctrl_c(child)
    assert "KeyboardInterrupt" in said and child.returncode != 0
    assert [file.name for file in sorted(Path(tmp_path / "set").iterdir())] == ["manifest.json"]
    assert len(dermis._dermis.create_train_set(skin, tmp_path / "set", 4000, shard_samples=400)) == 10


class Bar:
    """Records the calls to tqdm."""

    seen = []

    def __init__(self, *, desc, total, **_):
        self.desc, self.total, self.n, self.closed = desc, total, 0, False
        Bar.seen.append(self)

    def update(self, more):
        assert more >= 0
        self.n += more

    def refresh(self):
        self.n += 1

    def close(self):
        self.closed = True


@pytest.fixture
def bars(monkeypatch):
    """A recording tqdm, whether or not the real one is installed."""
    import types

    package, auto = types.ModuleType("tqdm"), types.ModuleType("tqdm.auto")
    auto.tqdm = Bar
    monkeypatch.setitem(sys.modules, "tqdm", package)
    monkeypatch.setitem(sys.modules, "tqdm.auto", auto)
    Bar.seen = []
    return Bar.seen


def until_interrupted(work):
    """Interrupts as soon as something is shown."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    begun, ended = time.monotonic(), threading.Event()

    def interrupt():
        while not ended.wait(0.01):
            if Bar.seen and Bar.seen[-1].n > 0 or time.monotonic() > begun + 300:
                os.kill(os.getpid(), signal.SIGINT)
                return

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            work()
    finally:
        ended.set()
        thread.join()


def test_progress_of_steps(skin, tmp_path, bars):
    until_interrupted(voltages_many(skin, tmp_path))
    (bar,) = bars
    assert bar.desc == "voltages" and bar.total == 20000 and 0 < bar.n < 20000 and bar.closed


def test_progress_of_work_without_steps(skin, tmp_path, bars):
    until_interrupted(tolerances(skin, tmp_path))
    (bar,) = bars
    assert bar.desc == "tolerances" and bar.total is None and bar.closed


def test_short_work_shows_nothing(disc, bars):
    disc.voltages_many(np.stack([disc.sigma]))
    assert not bars


def test_a_bar_that_fails_is_the_caller_s_to_know(skin, tmp_path, bars, monkeypatch):
    def fail(self, more):
        raise ZeroDivisionError("of the bar")

    monkeypatch.setattr(Bar, "update", fail)
    with pytest.raises(ZeroDivisionError, match="of the bar"):
        voltages_many(skin, tmp_path)()
