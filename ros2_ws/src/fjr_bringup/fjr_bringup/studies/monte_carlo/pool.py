# SPDX-License-Identifier: Apache-2.0
"""Who runs the parts of a campaign: threads of this process, or the workers of a Dask cluster; the same numbers."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass

from fjr_bringup.studies.monte_carlo.store import Store
from fjr_core.errors import FjrError
from fjr_core.experiments.monte_carlo.sweep import Columns, run_part

AHEAD = 3
"""Parts that are under way or waiting for each worker."""
LOOK = 0.2  # s between two looks at whether to stop


class ClusterError(FjrError):
    """A cluster that cannot be reached, or that failed."""


@dataclass(frozen=True)
class Workers:
    """An executor with how many it runs at once; remote: on other machines, perhaps."""

    executor: Executor
    count: int
    remote: bool = False


@contextmanager
def threads(count: int) -> Iterator[Workers]:
    """So many cores of this machine: compiled runs let other threads go on."""
    with ThreadPoolExecutor(count, thread_name_prefix="sweep") as executor:
        yield Workers(executor, count)


@contextmanager
def cluster(address: str, timeout: float = 10.0) -> Iterator[Workers]:
    """The workers of a running Dask scheduler, e.g. tcp://host:8786; raises ClusterError."""
    if "://" not in address:
        raise ClusterError(f"the scheduler's address is '{address}'; expected e.g. tcp://host:8786")
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise ClusterError(
            "dask.distributed is not installed here; expected it for --scheduler: "
            "pip install --constraint constraints.txt --requirement requirements/cluster.txt"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what goes wrong is said here, in a sentence
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(f"no Dask scheduler answers at {address} ({error}); expected e.g. tcp://host:8786") from None
    try:
        cores = sum(client.nthreads().values())
        if not cores:
            raise ClusterError(f"the Dask scheduler at {address} has no workers; expected at least one")
        yield Workers(client.get_executor(pure=False, retries=3), cores, remote=True)
    finally:
        client.close()


def carry_out(store: Store, workers: Workers, tell: Callable[[int], object], stop: threading.Event) -> bool:
    """Run what is missing and keep each part as it is finished; whether all is there (not when `stop` was set).

    tell: called with the number of runs of each part that is kept. At no time are more parts in memory than
    AHEAD for each worker.
    """
    missing, text, compiled = store.missing(), store.sweep.text, store.sweep.loop.compiled
    under_way: dict[Future[Columns], tuple[int, int]] = {}
    try:
        while not stop.is_set():
            for part in _next(missing, AHEAD * workers.count - len(under_way)):
                under_way[workers.executor.submit(run_part, text, *part, compiled)] = part
            if not under_way:
                return True
            done, _ = wait(under_way, timeout=LOOK, return_when=FIRST_COMPLETED)
            for future in done:
                begin, end = under_way.pop(future)
                store.keep(begin, end, _result(future, workers.remote))
                tell(end - begin)
        return False
    finally:
        for future in under_way:
            future.cancel()


def _result(future: Future[Columns], remote: bool) -> Columns:
    """What a worker made; what goes wrong elsewhere is a ClusterError."""
    try:
        return future.result()
    except FjrError:
        raise
    except Exception as error:
        if not remote:
            raise
        what = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        raise ClusterError(
            f"a worker of the cluster failed ({what}); expected this version of fjr_core on its Python path"
        ) from None


def _next(missing: Iterator[tuple[int, int]], count: int) -> list[tuple[int, int]]:
    return [part for _, part in zip(range(count), missing, strict=False)]
