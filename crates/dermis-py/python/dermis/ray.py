"""Distributes work that would take one machine too long over a Ray cluster (https://ray.io). Ray is imported only
here.

Seeds belong to samples and shards, not to workers, so results are bit-identical for any number of workers. Tasks lost
with their worker are run again. The output of a task appears under its name only when complete, so nothing is lost and
nothing duplicated.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import ray

from . import _dermis
from .errors import InputError

__all__ = ["reproduce", "sweep", "tolerances", "train_set"]

# What, samples, position_mm, amplitude_percent, misses_percent.
_Cost = tuple[str, int, list[float], list[float], float]
_Parameter = TypeVar("_Parameter")
_Result = TypeVar("_Result")

# Retries of a task whose worker died.
_RETRIES = 5
# Tasks in flight on the smallest cluster.
_LEAST_UNDER_WAY = 64
# Interval at which the driver collects results and sends further tasks, seconds.
_ROUND_S = 0.05


def _toml(skin: Any) -> str:
    return skin.to_toml() if isinstance(skin, _dermis.Skin) else _dermis.Skin(skin).to_toml()


def _fan_out(task: Callable[..., Any], arguments: list[tuple[Any, ...]], unit: str) -> list[Any]:
    """Runs a task over a list of arguments on the cluster; returns the results in the order of the list.

    Twice as many tasks are in flight as the cluster has processors, so that none waits for the driver, and the
    driver's work per task doesn't grow with the length of the list.
    """
    if not ray.is_initialized():
        ray.init()
    remote = ray.remote(num_cpus=1, max_retries=_RETRIES)(task)
    waiting = enumerate(arguments)
    pending: dict[Any, int] = {}
    results: list[Any] = [None] * len(arguments)
    bar = _progress(len(arguments), unit)
    while True:
        # Looked up each time, because clusters grow.
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
    """Limits a task to the one processor it asked for. Otherwise it would use its whole node, in competition with
    other tasks."""
    os.environ.setdefault("RAYON_NUM_THREADS", "1")


def _shard(toml: str, folder: str, shard: int, samples: int, shard_samples: int, seed: int) -> int:
    _keep_to_one_processor()
    skin = _dermis.Skin.from_toml(toml)
    return _dermis.write_shard(skin, folder, shard, samples, shard_samples=shard_samples, seed=seed)


def train_set(skin: Any, n: int, folder: str | Path, *, shard_samples: int = 250, seed: int = 1) -> Path:
    """Simulates a training set, or the missing part of one, into a folder that all workers can reach.

    Parameters
    ----------
    skin : dermis.Skin or str
        The skin.
    n : int
        Total number of samples.
    folder : str or pathlib.Path
        Output folder, on a file system shared by all nodes.
    shard_samples, seed : int
        Samples per shard, which is one task, and the seed of all random numbers. A shard depends only on the seed and
        its number, and equals the one made by ``dermis train-set``.

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


def _tolerance(toml: str, samples: int, presses: int, pokes: list[int], seed: int) -> list[_Cost]:
    _keep_to_one_processor()
    skin = _dermis.Skin.from_toml(toml)
    return _dermis.tolerance_rows(skin, samples=samples, presses=presses, pokes=pokes, seed=seed)


def tolerances(skin: Any, n: int, *, batch: int = 20, presses: int = 12, seed: int = 1) -> list[list[_Cost]]:
    """Estimates the cost of manufacturing errors for a skin, in batches of samples with their own seeds.

    Parameters
    ----------
    skin : dermis.Skin or str
        The skin.
    n : int
        Samples for each kind of error.
    batch : int
        Samples per task. Together with `seed` it determines the numbers, so it doesn't depend on the number of
        workers.
    presses, seed : int
        Presses per sample, and the seed of the first batch; the other batches use the following seeds.

    Returns
    -------
    list
        For each batch a list of `(what, samples, position_mm, amplitude_percent, misses_percent)`, with position and
        amplitude as median and 90th percentile.
    """
    if n < 1 or batch < 1:
        raise InputError(f"n, batch: expected 1 or more, got {n}, {batch}")
    toml = _toml(skin)
    starts = range(0, n, batch)
    tasks: list[tuple[Any, ...]] = [
        (toml, min(batch, n - start), presses, [], seed + number) for number, start in enumerate(starts)
    ]
    return _fan_out(_tolerance, tasks, "batch")


def sweep(
    skin: Any, parameters: Iterable[_Parameter], work: Callable[[_dermis.Skin, _Parameter], _Result]
) -> list[_Result]:
    """Runs a function for a skin and each of several parameters.

    Parameters
    ----------
    skin : dermis.Skin or str
        The skin, passed to every call.
    parameters : iterable
        The parameters; each makes one task.
    work : callable
        Called as ``work(skin, parameter)``; its result must be picklable.

    Returns
    -------
    list
        The results, in the order of the parameters.
    """
    toml = _toml(skin)

    def task(text: str, parameter: _Parameter) -> _Result:
        _keep_to_one_processor()
        return work(_dermis.Skin.from_toml(text), parameter)

    return _fan_out(task, [(toml, parameter) for parameter in parameters], "parameter")


def _experiment(which: str, folder: str, options: list[str]) -> int:
    _keep_to_one_processor()
    return _dermis.run_command(["dermis", "reproduce", which, "--out", folder, *options])


def reproduce(which: Iterable[str], folder: str | Path, options: Iterable[str] = ()) -> dict[str, int]:
    """Replays the experiments of published skins, one task each, into separate folders; returns their exit codes."""
    names, options = list(which), list(options)
    tasks: list[tuple[Any, ...]] = [(name, str(Path(folder).absolute() / name), options) for name in names]
    return dict(zip(names, _fan_out(_experiment, tasks, "experiment"), strict=True))
