# SPDX-License-Identifier: Apache-2.0
"""Run the jobs of a comparison in a process pool; finished jobs are kept and not run again."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from fjr_core.config.scenario import parse_scenario
from fjr_core.errors import CompareError
from fjr_core.files.text_file import is_sealed, read_json, write_text
from fjr_design.studies.comparison.job import Job, Result, work
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import plural, progress_bar

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n:.1f}/{total} laws on robots, {elapsed} < {remaining}"
QUIET = 2.0  # s until the progress bar appears
POLL = 0.2  # s between checks for finished jobs
_progress: Any = None


def run(jobs: Sequence[Job], kept: Path, cores: int, stop: threading.Event) -> list[Result]:
    """Return the results in the order of the jobs; write each into the folder `kept` as soon as it is finished.

    Raise the FjrError of a job, CompareError if a worker died, Interrupted when `stop` is set.
    """
    kept.mkdir(parents=True, exist_ok=True)
    results = {job.key: _read(kept, job) for job in jobs}
    missing = [job for job in jobs if results[job.key] is None]
    if missing:
        joints = {job.robot: parse_scenario(job.robot, job.scenarios[0][1]).robot.n for job in missing}
        longest_first = sorted(missing, key=lambda job: joints[job.robot], reverse=True)
        results |= _compute(longest_first, kept, cores, stop)
    return [result for job in jobs if (result := results[job.key]) is not None]


def _compute(jobs: Sequence[Job], kept: Path, cores: int, stop: threading.Event) -> dict[str, Result | None]:
    context = multiprocessing.get_context("spawn")
    progress = context.SimpleQueue()
    pool = ProcessPoolExecutor(min(cores, len(jobs)), context, _begin, (progress,))
    try:
        futures = {pool.submit(_done, job, kept): job for job in jobs}
        pool.submit(os.getpid)  # wakes the pool up, so that it watches all workers
        _follow(futures, progress, stop, kept)
        return {job.key: future.result() for future, job in futures.items()}
    except BrokenExecutor:
        raise CompareError(
            f"a worker process died (killed or out of memory). Finished results are in {kept}; "
            "run the same command again to continue, with fewer --cores if memory is short"
        ) from None
    finally:
        _terminate(pool)


def _follow(futures: dict[Future[Result], Job], progress: Any, stop: threading.Event, kept: Path) -> None:
    """Wait for all jobs with a progress bar; raise the error of the first that fails."""
    parts: dict[str, float] = dict.fromkeys((job.key for job in futures.values()), 0.0)
    line = f"compare: {plural(len(futures), 'law on a robot', 'laws on robots')} to run"
    with progress_bar(line, PROGRESS, total=len(futures), desc="compare", delay=QUIET) as bar:
        while True:
            finished, waiting = wait(futures, POLL)
            while not progress.empty():
                key, part = progress.get()
                parts[key] = part
            parts |= {futures[future].key: 1.0 for future in finished}
            bar.update(sum(parts.values()) - bar.n)
            if stop.is_set():
                raise Interrupted(kept if any(kept.glob("*.json")) else None)
            failed = next((error for future in finished if (error := future.exception())), None)
            if failed is not None:  # without waiting for the others
                raise failed
            if not waiting:
                return


def _begin(progress: Any) -> None:
    """Set up a worker: ignore Ctrl-C, which the parent handles; exit with the parent."""
    global _progress
    _progress = progress
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _done(job: Job, kept: Path) -> Result:
    """Run a job in a worker; write its result to a file and return it."""
    result = work(job, lambda part: _progress.put((job.key, part)))
    path = kept / f"{job.key}.json"
    write_text(path, json.dumps(result, allow_nan=False), sealed=True)
    return result


def _terminate(pool: ProcessPoolExecutor) -> None:
    """Terminate the workers; unfinished jobs are run again next time."""
    for worker in list((pool._processes or {}).values()):
        worker.terminate()
    pool.shutdown(cancel_futures=True)  # waits for the pool's thread, which may otherwise outlive its pipes


def _read(kept: Path, job: Job) -> Result | None:
    """Return the kept result of a job; None if it is missing or changed."""
    path = kept / f"{job.key}.json"
    try:
        return read_json(path) if is_sealed(path) else None
    except (OSError, ValueError):
        return None
