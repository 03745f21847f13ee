# SPDX-License-Identifier: Apache-2.0
"""The engine of all studies: a folder that can be resumed, and workers that run its missing jobs.

A study is its description, plain values: studies with equal descriptions, run by the same program, have equal results.
It consists of independent jobs, each of which is kept as soon as it is finished, so that the same command goes on where
Ctrl-C, a kill or a power cut ended it. Jobs run in threads (a sweep: compiled runs release the GIL), in processes (a
comparison: much of its work is Python) or on a Dask cluster, with equal results. Threads share the study of the jobs;
another process or machine makes it from its description (`sent_as_text`). The folder of a sweep or a tuning:

study.json       description of the study and hash of the program
parts/           <key>.parquet: the runs of each finished job
table.parquet    all runs: of a sweep once all jobs are finished, instead of the parts; of a tuning after each job
"""

from __future__ import annotations

import fcntl
import json
import logging
import multiprocessing
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import PIP, FjrError, MissingPackageError
from fjr_core.files.text_file import is_sealed, read_json, whole_file, write_text
from fjr_msgs_py.console.ending import Interrupted

AHEAD = 3  # jobs submitted per worker; no more results than these are in memory
LOOK = 0.2  # s between checks of `stop`
DESCRIPTION = "study.json"
Columns = dict[str, NDArray[Any]]  # values of the runs of a job by name, (runs,) each
Job = tuple[Any, ...]  # arguments of the function that computes the result of a job


class StoreError(FjrError):
    """A folder that holds another study or is in use."""


class WorkerError(FjrError):
    """Workers, of this machine or of a cluster, are unreachable or failed."""


def _parquet() -> Any:
    """Return pyarrow with its module for Parquet files, loaded on use: no other command needs it."""
    try:
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise MissingPackageError(f"pyarrow is not installed; expected it for a study: {PIP} pyarrow") from None
    return pyarrow


@dataclass(frozen=True)
class Kept:
    """Folder of the results of finished jobs by their keys, plain values in a JSON file each."""

    folder: Path

    def holds(self, key: str) -> bool:
        """Return whether a job is finished and its file is as it was written."""
        return is_sealed(self._file(key))

    def run(
        self,
        workers: Workers,
        work: Callable[..., Any],
        jobs: Mapping[str, Job],
        stop: threading.Event,
        on_kept: Callable[[Any], object] = lambda result: None,
        on_look: Callable[[], object] = lambda: None,
    ) -> None:
        """Run work(*job) for the jobs by their keys that are not finished; keep each result, in this thread.

        on_kept: called with each result. on_look: called at least every LOOK. Raise Interrupted if `stop` is set, the
        error of the first job that fails, without waiting for the others, WorkerError for one on another machine.
        """
        waiting = iter([(key, job) for key, job in jobs.items() if not self.holds(key)])
        pending: dict[Future[Any], str] = {}
        try:
            while not stop.is_set():
                for key, job in islice(waiting, AHEAD * workers.count - len(pending)):
                    pending[workers.executor.submit(work, *job)] = key
                if not pending:
                    return
                done, _ = wait(pending, timeout=LOOK, return_when=FIRST_COMPLETED)
                for future in done:
                    result = workers.result(future)
                    self.keep(pending.pop(future), result)
                    on_kept(result)
                on_look()
        finally:
            for future in pending:
                future.cancel()
        raise Interrupted(self.folder if any(map(self.holds, jobs)) else None)

    def keep(self, key: str, result: Any) -> None:
        """Write the result of a finished job atomically."""
        write_text(self._file(key), json.dumps(result, allow_nan=False), sealed=True)

    def read(self, key: str) -> Any:
        """Return the result of a finished job."""
        return read_json(self._file(key))

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.json"


class Store(Kept):
    """Folder of a sweep or a tuning: the columns of each finished job as Parquet; create it by `open_store`."""

    @property
    def table(self) -> Path:
        """Path of the table of all runs."""
        return self.folder / "table.parquet"

    def keep(self, key: str, result: Columns) -> None:
        """Write the columns of a finished job atomically."""
        pa = _parquet()
        with whole_file(self._file(key), sealed=True) as scratch:
            pa.parquet.write_table(pa.table(result), scratch, compression="zstd")

    def read(self, key: str) -> Columns:
        """Return the columns of a finished job."""
        found = _parquet().parquet.read_table(self._file(key))
        return {name: found.column(name).to_numpy() for name in found.column_names}

    def write_table(self, keys: Sequence[str]) -> Path:
        """Write the table of these jobs, in their order; return its path."""
        parquet, files = _parquet().parquet, [self._file(key) for key in keys]
        with (
            whole_file(self.table, sealed=True) as scratch,
            parquet.ParquetWriter(scratch, parquet.read_schema(files[0]), compression="zstd") as writer,
        ):
            for file in files:
                writer.write_table(parquet.read_table(file))
        return self.table

    def remove_parts(self) -> None:
        """Remove the files of the jobs, which the table holds."""
        for file in (self.folder / "parts").glob("*"):
            file.unlink()

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of the table (runs,)."""
        return np.asarray(_parquet().parquet.read_table(self.table, columns=[name]).column(0).to_numpy())

    def _file(self, key: str) -> Path:
        return self.folder / "parts" / f"{key}.parquet"


@contextmanager
def open_store(folder: Path, text: str, program: str) -> Iterator[Store]:
    """Open or create the folder of a study, locked for this process; raise StoreError, MissingPackageError.

    text: description of the study as JSON. program: hash of the code that computes the results.
    """
    _parquet()
    (folder / "parts").mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"{folder} is in use by another process; expected one at a time") from None
        _check(folder, json.loads(text), program)
        for left in folder.rglob("*.part"):
            left.unlink()
        store = Store(folder)
        if store.table.exists() and not is_sealed(store.table):
            raise StoreError(
                f"{store.table} is not what this command wrote (its SHA-256 digest differs); expected it unchanged, or "
                "removed to compute it again"
            )
        yield store


def _check(folder: Path, wanted: Mapping[str, Any], program: str) -> None:
    """Write the description of a study, or check that the folder holds the same; raise StoreError."""
    path = folder / DESCRIPTION
    try:
        found = read_json(path)
    except FileNotFoundError:
        if any(folder.rglob("*.parquet")):
            raise StoreError(
                f"{folder} holds runs without their {DESCRIPTION}; expected both, or another --output"
            ) from None
        write_text(path, json.dumps({**wanted, "program": program}, indent=1))
        return
    except ValueError:
        raise StoreError(f"{path} cannot be read; expected the file that this command wrote") from None
    differences = [_difference(name, found.get(name), here) for name, here in wanted.items() if found.get(name) != here]
    if differences:
        raise StoreError(
            f"{folder} holds another study ({', '.join(differences)}); expected the same one, or another --output"
        )
    if found.get("program") != program:
        raise StoreError(
            f"{folder} was started by another version of this program (source, CasADi, C compiler); "
            "expected the same version, or another --output"
        )


def _difference(name: str, there: object, here: object) -> str:
    if isinstance(there, (int, float)) and isinstance(here, (int, float)):
        return f"{name} is {there:g}, not {here:g}"
    if isinstance(there, dict) and isinstance(here, dict):
        return f"{name} differs in {', '.join(sorted(k for k in {*there, *here} if there.get(k) != here.get(k)))}"
    return f"{name} differs"


def divided(begin: int, end: int, size: int) -> list[tuple[int, int]]:
    """Return the runs begin .. end - 1 in parts (begin, end) of at most `size` runs."""
    return [(first, min(first + size, end)) for first in range(begin, end, size)]


class Study(ABC):
    """A study, an argument of its jobs: threads share it, another process or machine makes it of its text, once."""

    @property
    @abstractmethod
    def text(self) -> str:
        """Description as JSON; studies with equal text have equal results."""

    @classmethod
    @abstractmethod
    def from_text(cls, text: str) -> Study:
        """Return the study with this text."""

    @abstractmethod
    def build(self) -> None:
        """Compile what the jobs need."""

    def __reduce__(self) -> tuple[Callable[..., Study], tuple[type[Study], str]]:
        return _received, (type(self), self.text)


_receiving = threading.Lock()


def _received(kind: type[Study], text: str) -> Study:
    with _receiving:
        return _made(kind, text)


@lru_cache(maxsize=4)
def _made(kind: type[Study], text: str) -> Study:
    study = kind.from_text(text)
    study.build()
    return study


@dataclass(frozen=True)
class Workers:
    """Executor and its number of parallel jobs; remote: possibly on other machines."""

    executor: Executor
    count: int
    remote: bool = False

    def result(self, future: Future[Any]) -> Any:
        """Return the result of a job that is done; raise its error, WorkerError for one on another machine."""
        try:
            return future.result()
        except FjrError:
            raise
        except Exception as error:
            if not self.remote:
                raise
            what = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
            raise WorkerError(
                f"a worker of the cluster failed ({what}); expected this version of fjr_core on its Python path"
            ) from None


@contextmanager
def threads(count: int) -> Iterator[Workers]:
    """Yield `count` threads of this process; compiled runs release the GIL."""
    with ThreadPoolExecutor(count, thread_name_prefix="study") as executor:
        yield Workers(executor, count)


@contextmanager
def cluster(address: str, timeout: float = 10.0) -> Iterator[Workers]:
    """Yield the workers of a running Dask scheduler, e.g. tcp://host:8786; raise WorkerError."""
    if "://" not in address:
        raise WorkerError(f"the scheduler's address is '{address}'; expected e.g. tcp://host:8786")
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise WorkerError(
            "dask.distributed is not installed here; expected it for --scheduler, at the version of the cluster: "
            f"{PIP} distributed"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are reported here, in one sentence
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise WorkerError(f"no Dask scheduler answers at {address} ({error}); expected e.g. tcp://host:8786") from None
    try:
        cores = sum(client.nthreads().values())
        if not cores:
            raise WorkerError(f"the Dask scheduler at {address} has no workers; expected at least one")
        yield Workers(client.get_executor(pure=False, retries=3), cores, remote=True)
    finally:
        client.close()


_done: Any = None  # shares of the jobs, in a worker process


def report_share(number: int, share: float) -> None:
    """Report the finished share of a job, 0 to 1, by its number to the parent of this worker process."""
    if _done is not None:
        _done[number] = share


@contextmanager
def processes(count: int, jobs: int) -> Iterator[tuple[Workers, Sequence[float]]]:
    """Yield `count` processes of this machine, and the shares that they report of their jobs.

    In the end they are terminated, whether or not their jobs are finished. They end with this process even if it is
    killed, and leave Ctrl-C to it.
    """
    context = multiprocessing.get_context("spawn")
    done: Any = context.RawArray("d", jobs)  # without a lock, which a killed worker could keep
    pool = ProcessPoolExecutor(count, context, _begin, (done,))
    try:
        for _ in range(count + 1):  # starts all processes, then wakes the pool up, so that it watches all of them
            pool.submit(os.getpid)
        yield Workers(pool, count), done
    finally:
        for worker in list((pool._processes or {}).values()):
            worker.terminate()
        pool.shutdown(cancel_futures=True)  # waits for the pool's thread, which may otherwise outlive its pipes


def _begin(done: Any) -> None:
    """Set up a worker: ignore Ctrl-C, which the parent handles; exit with the parent."""
    global _done
    _done = done
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
