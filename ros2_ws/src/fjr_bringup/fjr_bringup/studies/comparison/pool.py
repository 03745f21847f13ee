# SPDX-License-Identifier: Apache-2.0
"""All jobs of a comparison on the machine's cores: finished ones are kept and not done again, whatever ends it."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from tqdm import tqdm

from fjr_bringup.atomic_file import is_sealed, write_text
from fjr_bringup.formatting import plural
from fjr_bringup.interrupt import Interrupted
from fjr_bringup.studies.comparison.job import Job, Result, work
from fjr_core.config.scenario import parse_scenario
from fjr_core.errors import CompareError
from fjr_core.files.text_file import read_json

QUIET = 2.0  # s without a progress bar
GLANCE = 0.2  # s between looks at what is done
_told: Any = None


def run(jobs: Sequence[Job], kept: Path, cores: int, stop: threading.Event) -> list[Result]:
    """Results in the order of the jobs; each is written into the folder `kept` as it comes.

    Raises FjrError of a job, CompareError where a worker died, and Interrupted when `stop` is set.
    """
    kept.mkdir(parents=True, exist_ok=True)
    results = {job.key: _read(kept, job) for job in jobs}
    missing = [job for job in jobs if results[job.key] is None]
    if missing:
        results |= _computed(sorted(missing, key=_size, reverse=True), kept, cores, stop)
    return [result for job in jobs if (result := results[job.key]) is not None]


def _size(job: Job) -> int:
    """Joints: what takes longest comes first."""
    return parse_scenario(job.robot, job.scenarios[0][1]).robot.n


def _computed(jobs: Sequence[Job], kept: Path, cores: int, stop: threading.Event) -> dict[str, Result | None]:
    context = multiprocessing.get_context("spawn")
    told = context.SimpleQueue()
    pool = ProcessPoolExecutor(min(cores, len(jobs)), context, _begin, (told,))
    try:
        futures = {pool.submit(_done, job, kept): job for job in jobs}
        pool.submit(os.getpid)  # the pool sees the death of those workers only that were there when it last woke up
        _follow(futures, told, stop, kept)
        return {job.key: future.result() for future, job in futures.items()}
    except BrokenExecutor:
        raise CompareError(
            f"a process that ran a law has ended (killed, or short of memory); what is finished is in {kept}, "
            "expected them all to end by themselves: the same command goes on, with fewer --cores in less memory"
        ) from None
    finally:
        _end(pool)


def _follow(futures: dict[Future[Result], Job], told: Any, stop: threading.Event, kept: Path) -> None:
    """Wait for all, with a bar; raises what the first that fails has raised."""
    parts: dict[str, float] = dict.fromkeys((job.key for job in futures.values()), 0.0)
    with _bar(len(futures)) as bar:
        while True:
            finished, waiting = wait(futures, GLANCE)
            while not told.empty():
                key, part = told.get()
                parts[key] = part
            parts |= {futures[future].key: 1.0 for future in finished}
            bar.update(sum(parts.values()) - bar.n)
            if stop.is_set():
                raise Interrupted(kept if any(kept.glob("*.json")) else None)
            failed = next((error for future in finished if (error := future.exception())), None)
            if failed is not None:  # the others are not waited for
                raise failed
            if not waiting:
                return


def _bar(total: int) -> tqdm[Any]:
    """On a terminal; elsewhere one line."""
    terminal = sys.stderr.isatty()
    if not terminal:
        print(f"compare: {plural(total, 'law on a robot', 'laws on robots')} to run", file=sys.stderr, flush=True)
    form = "{desc}: {percentage:3.0f}% |{bar}| {n:.1f}/{total} laws on robots, {elapsed} < {remaining}"
    return tqdm(total=total, desc="compare", bar_format=form, delay=QUIET, disable=not terminal, file=sys.stderr)


def _begin(told: Any) -> None:
    """In a worker: Ctrl-C is the parent's to answer; without the parent there is nothing to do."""
    global _told
    _told = told
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _done(job: Job, kept: Path) -> Result:
    """In a worker: the result, once it is in a file."""
    result = work(job, lambda part: _told.put((job.key, part)))
    path = kept / f"{job.key}.json"
    write_text(path, json.dumps(result, allow_nan=False), sealed=True)
    return result


def _end(pool: ProcessPoolExecutor) -> None:
    """Nothing is waited for: what is unfinished is done again another time."""
    for worker in list((pool._processes or {}).values()):
        worker.terminate()
    pool.shutdown(cancel_futures=True)  # waits for the thread that minds the workers, else it may outlive its pipes


def _read(kept: Path, job: Job) -> Result | None:
    """The result of a job; None where there is none with the content that it was kept with."""
    path = kept / f"{job.key}.json"
    try:
        return read_json(path) if is_sealed(path) else None
    except (OSError, ValueError):
        return None
