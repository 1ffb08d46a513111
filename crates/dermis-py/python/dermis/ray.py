"""Work that one machine cannot do in time, on a Ray cluster (https://ray.io), which is imported here and nowhere else.

Seeds belong to samples and shards, not to workers: results are the same bits whatever the number of workers. Tasks that are
lost with their worker are run again; what a task writes appears under its name only when it is whole, so that nothing is
lost and nothing doubled.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import ray

from . import _dermis
from .errors import InputError

__all__ = ["reproduce", "sweep", "tolerances", "train_set"]

# How often a task is tried again that went down with its worker.
_RETRIES = 5
# Tasks that are under way on the smallest cluster.
_LEAST_UNDER_WAY = 64
# How often the driver looks for results and sends further tasks, seconds.
_ROUND_S = 0.05


def _toml(skin: Any) -> str:
    return skin.to_toml() if isinstance(skin, _dermis.Skin) else _dermis.Skin(skin).to_toml()


def _fan_out(task: Callable[..., Any], arguments: list[tuple[Any, ...]], unit: str) -> list[Any]:
    """Runs a task over a list of arguments on the cluster; the results in the order of the list.

    Twice as many tasks as the cluster has processors are under way, so that none waits for the driver, and what the driver
    does for a task does not grow with the length of the list.
    """
    if not ray.is_initialized():
        ray.init()
    remote = ray.remote(num_cpus=1, max_retries=_RETRIES)(task)
    waiting = enumerate(arguments)
    pending: dict[Any, int] = {}
    results: list[Any] = [None] * len(arguments)
    bar = _progress(len(arguments), unit)
    while True:
        # Looked up each time: clusters grow.
        most = max(_LEAST_UNDER_WAY, 2 * int(ray.cluster_resources().get("CPU", 1)))
        for place, of in itertools.islice(waiting, max(0, most - len(pending))):
            pending[remote.remote(*of)] = place
        if not pending:
            break
        done, _ = ray.wait(list(pending), num_returns=len(pending), timeout=_ROUND_S)
        for reference, result in zip(done, ray.get(done), strict=True):
            results[pending.pop(reference)] = result
        if bar is not None:
            bar.update(len(done))
    if bar is not None:
        bar.close()
    return results


def _progress(total: int, unit: str) -> Any:
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return None
    return tqdm(total=total, unit=unit, leave=False)


def _keep_to_one_processor() -> None:
    """A task has asked for one processor; without this it would take all of its node, beside the other tasks there."""
    os.environ.setdefault("RAYON_NUM_THREADS", "1")


def _shard(toml: str, folder: str, shard: int, samples: int, shard_samples: int, seed: int) -> int:
    _keep_to_one_processor()
    skin = _dermis.Skin.from_toml(toml)
    return _dermis.write_shard(skin, folder, shard, samples, shard_samples=shard_samples, seed=seed)


def train_set(skin: Any, n: int, folder: str | Path, *, shard_samples: int = 250, seed: int = 1) -> Path:
    """Simulates a training set into a folder that all workers reach, or what is missing of it.

    Parameters
    ----------
    skin : dermis.Skin or str
        The skin.
    n : int
        Samples in all.
    folder : str or pathlib.Path
        Where: a file system that all nodes share.
    shard_samples, seed : int
        Samples a shard, which is what a task makes, and the seed of everything random. A shard depends on the seed and its
        number alone: the same as ``dermis train-set`` makes.

    Returns
    -------
    pathlib.Path
        The folder.
    """
    toml, folder = _toml(skin), Path(folder).absolute()
    of = _dermis.Skin.from_toml(toml)
    missing = _dermis.create_train_set(of, folder, n, shard_samples=shard_samples, seed=seed)
    _fan_out(_shard, [(toml, str(folder), shard, n, shard_samples, seed) for shard in missing], "shard")
    return folder


def _tolerance(toml: str, samples: int, presses: int, pokes: list[int], seed: int) -> list[tuple[Any, ...]]:
    _keep_to_one_processor()
    skin = _dermis.Skin.from_toml(toml)
    return _dermis.tolerance_rows(skin, samples=samples, presses=presses, pokes=pokes, seed=seed)


def tolerances(skin: Any, n: int, *, batch: int = 20, presses: int = 12, seed: int = 1) -> list[list[tuple[Any, ...]]]:
    """What a workshop's errors cost a skin, in batches of samples with seeds of their own.

    Parameters
    ----------
    skin : dermis.Skin or str
        The skin.
    n : int
        Samples of every kind of error.
    batch : int
        Samples a task; together with `seed` it decides the numbers, and so does not follow the number of workers.
    presses, seed : int
        Presses a sample, and the seed of the first batch; those of the others follow it.

    Returns
    -------
    list
        A list for each batch of `(what, samples, position_mm, amplitude_percent, misses_percent)`, position and amplitude as
        median and 90th percentile.
    """
    if n < 1 or batch < 1:
        raise InputError(f"n, batch: expected 1 or more, got {n}, {batch}")
    toml = _toml(skin)
    starts = range(0, n, batch)
    tasks: list[tuple[Any, ...]] = [
        (toml, min(batch, n - start), presses, [], seed + number) for number, start in enumerate(starts)
    ]
    return _fan_out(_tolerance, tasks, "batch")


def sweep(skin: Any, parameters: Iterable[Any], work: Callable[[_dermis.Skin, Any], Any]) -> list[Any]:
    """Does work for a skin and each of some parameters.

    Parameters
    ----------
    skin : dermis.Skin or str
        The skin, given to every call.
    parameters : iterable
        What varies; each is one task.
    work : callable
        ``work(skin, parameter)``; what it returns has to be picklable.

    Returns
    -------
    list
        What it returned, in the order of the parameters.
    """
    toml = _toml(skin)

    def task(text: str, parameter: Any) -> Any:
        _keep_to_one_processor()
        return work(_dermis.Skin.from_toml(text), parameter)

    return _fan_out(task, [(toml, parameter) for parameter in parameters], "parameter")


def _experiment(which: str, folder: str, options: list[str]) -> int:
    _keep_to_one_processor()
    return _dermis.run_command(["dermis", "reproduce", which, "--out", folder, *options])


def reproduce(which: Iterable[str], folder: str | Path, options: Iterable[str] = ()) -> dict[str, int]:
    """Replays the experiments of published skins, one task each, into folders of their own; their exit codes."""
    names, options = list(which), list(options)
    tasks: list[tuple[Any, ...]] = [(name, str(Path(folder).absolute() / name), options) for name in names]
    return dict(zip(names, _fan_out(_experiment, tasks, "experiment"), strict=True))
