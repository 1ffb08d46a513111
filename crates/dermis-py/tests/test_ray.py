"""Work on a cluster of two workers, one of which is killed: identical bits, nothing lost, nothing duplicated."""

import hashlib
import os
import signal
import threading
import time
from pathlib import Path

import pytest

import dermis

ray = pytest.importorskip("ray", reason="Ray is not installed")


def hashes(folder):
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(Path(folder).glob("*"))}


@pytest.fixture(scope="module")
def cluster():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield
    ray.shutdown()


def test_a_training_set_with_a_worker_killed(cluster, tmp_path):
    from dermis.ray import train_set

    alone = tmp_path / "alone"
    skin = dermis.Skin("healing-square")
    missing = dermis._dermis.create_train_set(skin, alone, 12, shard_samples=2, seed=5)
    for shard in missing:
        dermis._dermis.write_shard(skin, alone, shard, 12, shard_samples=2, seed=5)
    killed = []

    def kill_one():
        deadline = time.monotonic() + 60
        while not killed and time.monotonic() < deadline:
            time.sleep(0.05)
            for process in Path("/proc").glob("[0-9]*/cmdline"):
                try:
                    line = process.read_bytes()
                except OSError:
                    continue
                if line.startswith(b"ray::_shard"):
                    os.kill(int(process.parent.name), signal.SIGKILL)
                    killed.append(process.parent.name)
                    return

    thread = threading.Thread(target=kill_one)
    thread.start()
    together = train_set(skin, 12, tmp_path / "together", shard_samples=2, seed=5)
    thread.join()
    assert killed, "no worker was seen to kill"
    assert hashes(together) == hashes(alone) and len(hashes(alone)) == 7
    # Existing shards are not made again.
    before = {file: file.stat().st_mtime_ns for file in together.iterdir()}
    train_set(skin, 12, together, shard_samples=2, seed=5)
    assert before == {file: file.stat().st_mtime_ns for file in together.iterdir()}


def test_sweeps_keep_their_order(cluster):
    from dermis.ray import sweep

    sums = sweep("hydrogel-disc", [300, 400, 500], lambda skin, elements: float(skin.model(elements=elements).sigma.sum()))
    skin = dermis.Skin("hydrogel-disc")
    assert sums == [float(skin.model(elements=elements).sigma.sum()) for elements in (300, 400, 500)]
