#!/usr/bin/env python3
"""The cost of a training set on a local Ray cluster with 1, 2 and 4 workers, and the cost of a killed worker.

    pip install ray psutil dist/dermis-*.whl
    python crates/dermis-py/benches/cluster.py [samples=240] [shard=20] [skin=healing-square]

Every run makes the same set; its files are compared byte by byte with those of one process without Ray.
"""

import hashlib
import os
import signal
import sys
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
import ray

import dermis
from dermis import _dermis


def hashes(folder):
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(Path(folder).iterdir())}


def tasks():
    """The processes working on a shard."""
    for process in psutil.process_iter():
        try:
            if (process.cmdline() or [""])[0].startswith("ray::_shard"):
                yield process
        except psutil.Error:
            pass


def watch(stop, seen, kill):
    """Records the peak memory of a worker, resident and unshared; kills one on request."""
    while not stop.wait(0.05):
        for process in tasks():
            try:
                memory = process.memory_full_info()
            except psutil.Error:
                continue
            seen["rss"] = max(seen.get("rss", 0), memory.rss)
            seen["uss"] = max(seen.get("uss", 0), memory.uss)
            if kill and "killed" not in seen:
                os.kill(process.pid, signal.SIGKILL)
                seen["killed"] = process.pid


def measure(workers, skin, samples, shard, folder, kill=False):
    from dermis.ray import train_set

    ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False, configure_logging=False)
    # Start the workers before the clock.
    ray.get([ray.remote(num_cpus=1)(lambda: time.sleep(0.2)).remote() for _ in range(2 * workers)])
    stop, seen = threading.Event(), {}
    watcher = threading.Thread(target=watch, args=(stop, seen, kill))
    watcher.start()
    driver = psutil.Process().cpu_times()
    begun = time.perf_counter()
    train_set(skin, samples, folder, shard_samples=shard, seed=5)
    took = time.perf_counter() - begun
    spent = psutil.Process().cpu_times()
    stop.set()
    watcher.join()
    ray.shutdown()
    driver_s = spent.user + spent.system - driver.user - driver.system
    return took, driver_s, seen


def dispatch(workers=2, count=2000):
    """Wall-clock time and CPU time of the driver per empty task with arguments like a shard's, seconds, and the size of
    the arguments, bytes."""
    from dermis.ray import _fan_out

    toml = dermis.Skin("healing-square").to_toml()
    ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False, configure_logging=False)
    _fan_out(empty, [(toml, number) for number in range(50)], "task")
    driver = psutil.Process().cpu_times()
    begun = time.perf_counter()
    _fan_out(empty, [(toml, number) for number in range(count)], "task")
    took = time.perf_counter() - begun
    spent = psutil.Process().cpu_times()
    ray.shutdown()
    return took / count, (spent.user + spent.system - driver.user - driver.system) / count, len(toml)


def empty(toml, number):
    return number


def main():
    words = {"samples": "240", "shard": "20", "skin": "healing-square", **dict(word.split("=", 1) for word in sys.argv[1:])}
    samples, shard, skin = int(words["samples"]), int(words["shard"]), words["skin"]
    print(f"train_set({skin!r}, {samples}), {shard} samples per shard, {os.cpu_count()} processors")
    with TemporaryDirectory() as folder:
        alone = Path(folder) / "alone"
        begun = time.perf_counter()
        for number in _dermis.create_train_set(skin, alone, samples, shard_samples=shard, seed=5):
            _dermis.write_shard(skin, alone, number, samples, shard_samples=shard, seed=5)
        took = time.perf_counter() - begun
        wanted = hashes(alone)
        size = sum(file.stat().st_size for file in alone.iterdir())
        print(f"without Ray: {took:.1f} s, {samples / took:.1f} samples/s; {size} bytes in total, {size / samples:.0f} per sample", flush=True)
        for workers, kill in ((1, False), (2, False), (4, False), (2, True)):
            together = Path(folder) / f"{workers}-{kill}"
            took, driver_s, seen = measure(workers, skin, samples, shard, together, kill)
            same = "the same bytes" if hashes(together) == wanted else "DIFFERENT BYTES"
            killed = ", one killed" if "killed" in seen else ""
            print(
                f"{workers} workers{killed}: {took:.1f} s, {samples / took:.1f} samples/s, {same}; driver {driver_s:.2f} s of CPU; "
                f"worker {seen['rss'] / 2**20:.0f} MiB resident, {seen['uss'] / 2**20:.0f} MiB unshared",
                flush=True,
            )
    clock_s, driver_s, words = dispatch()
    print(f"empty task: {1e3 * clock_s:.2f} ms wall clock, {1e3 * driver_s:.2f} ms driver CPU, {words} bytes of arguments")


if __name__ == "__main__":
    main()
