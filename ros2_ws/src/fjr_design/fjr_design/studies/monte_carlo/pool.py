# SPDX-License-Identifier: Apache-2.0
"""Run the parts of a Monte-Carlo study in threads or on a Dask cluster, with equal results."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

from fjr_core.errors import FjrError
from fjr_design.experiments.monte_carlo.sweep import Columns, run_part
from fjr_design.studies.monte_carlo.store import Store

AHEAD = 3
"""Parts submitted per worker."""
LOOK = 0.2  # s between checks of `stop`
Result = TypeVar("Result")


class ClusterError(FjrError):
    """A cluster is unreachable or failed."""


@dataclass(frozen=True)
class Workers:
    """Executor and its number of parallel tasks; remote: possibly on other machines."""

    executor: Executor
    count: int
    remote: bool = False


@contextmanager
def threads(count: int) -> Iterator[Workers]:
    """Yield `count` threads of this process; compiled runs release the GIL."""
    with ThreadPoolExecutor(count, thread_name_prefix="sweep") as executor:
        yield Workers(executor, count)


@contextmanager
def cluster(address: str, timeout: float = 10.0) -> Iterator[Workers]:
    """Yield the workers of a running Dask scheduler, e.g. tcp://host:8786; raise ClusterError."""
    if "://" not in address:
        raise ClusterError(f"the scheduler's address is '{address}'; expected e.g. tcp://host:8786")
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise ClusterError(
            "dask.distributed is not installed here; expected it for --scheduler, at the version of the cluster: "
            "pip install distributed"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are reported here, in one sentence
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


def run_missing(store: Store, workers: Workers, on_progress: Callable[[int], object], stop: threading.Event) -> bool:
    """Run the missing parts and store each when finished; return whether all are stored (not if `stop` was set).

    on_progress: called with the number of runs of each stored part. At most AHEAD parts per worker are in memory.
    """
    missing, text = store.missing(), store.sweep.text
    pending: dict[Future[Columns], tuple[int, int]] = {}
    try:
        while not stop.is_set():
            for part in islice(missing, AHEAD * workers.count - len(pending)):
                pending[workers.executor.submit(run_part, text, *part)] = part
            if not pending:
                return True
            done, _ = wait(pending, timeout=LOOK, return_when=FIRST_COMPLETED)
            for future in done:
                begin, end = pending.pop(future)
                store.keep(begin, end, result_of(future, workers.remote))
                on_progress(end - begin)
        return False
    finally:
        for future in pending:
            future.cancel()


def result_of(future: Future[Result], remote: bool) -> Result:
    """Return the result of a worker; raise ClusterError for errors on another machine."""
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
