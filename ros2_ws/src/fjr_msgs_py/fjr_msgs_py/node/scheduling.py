# SPDX-License-Identifier: Apache-2.0
"""Real-time settings of a process: priority, locked memory, cores, garbage collector.

A setting that the system refuses is reported in one sentence and never raises: the node runs without it.
This module imports neither NumPy nor CasADi.
"""

from __future__ import annotations

import ctypes
import gc
import os
import resource
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fjr_core.config.process import ProcessSettings

_MCL_CURRENT, _MCL_FUTURE = 1, 2  # sys/mman.h of Linux
_CAP_IPC_LOCK = 14  # linux/capability.h


def apply_process_settings(settings: ProcessSettings) -> list[str]:
    """Apply the settings to this process; return one sentence for each that the system refuses."""
    refusals = (
        use_cores(settings.cores),
        lock_memory() if settings.lock_memory else "",
        take_priority(settings.priority),
    )
    return [sentence for sentence in refusals if sentence]


def take_priority(priority: int, inherited: bool = True) -> str:
    """Schedule every thread of this process as SCHED_FIFO at `priority`; 0 leaves the scheduling unchanged.

    inherited: threads and processes started later inherit the priority.
    Return "", or one sentence with the reason of the refusal.
    """
    if priority == 0:
        return ""
    try:
        _schedule(os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK), priority)
    except (OSError, AttributeError) as error:
        return (
            f"realtime_priority {priority} is refused ({error}): ordinary scheduling is used, cycles may be late; "
            "allow it by an rtprio limit (/etc/security/limits.conf) or CAP_SYS_NICE, or set realtime_priority to 0"
        )
    return ""


def yield_to_other_threads(priority: int) -> None:
    """Schedule the calling thread one step below `priority`, which the other threads of this process have.

    A native loop and the middleware then never wait for Python. Do nothing for a priority of 0 or where it is refused.
    """
    if priority > 1:
        with suppress(OSError, AttributeError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority - 1))


@contextmanager
def prioritised(priority: int) -> Iterator[None]:
    """Schedule this process as SCHED_FIFO inside the block if the system allows it.

    Child processes and threads started inside the block do not inherit the priority: a process that loads at this
    priority takes a whole core, and the kernel then suspends all real-time threads on it, those of running nodes
    included, for 50 ms of each second (kernel.sched_rt_runtime_us).
    """
    refused = take_priority(priority, inherited=False)
    try:
        yield
    finally:
        if priority and not refused:
            try:
                _schedule(os.SCHED_OTHER, 0)
            except PermissionError:  # only a privileged process may clear SCHED_RESET_ON_FORK
                _schedule(os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)


@contextmanager
def ahead_of_new_threads() -> Iterator[bool]:
    """Let threads that are started inside the block wait until this one sleeps or leaves it; yield False if refused.

    This thread runs as SCHED_FIFO on its present core, to which new threads are confined, too. Use it for milliseconds.
    """
    try:
        cores, policy, setting = os.sched_getaffinity(0), os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setaffinity(0, {_present_core()})
    except (OSError, AttributeError):
        yield False
        return
    try:
        yield policy in (os.SCHED_FIFO, os.SCHED_RR) or not take_priority(1)
    finally:
        for thread in _threads():
            with suppress(OSError):
                os.sched_setaffinity(thread, cores)
                os.sched_setscheduler(thread, policy, setting)


def use_cores(cores: frozenset[int]) -> str:
    """Restrict every thread of this process to these cores; an empty set leaves the affinity unchanged.

    Return "", or one sentence with the reason of a complete or partial refusal.
    """
    if not cores:
        return ""
    error = ""
    try:
        for thread in _threads():
            with suppress(ProcessLookupError):
                os.sched_setaffinity(thread, cores)
        used = os.sched_getaffinity(0)
    except AttributeError:
        return "cpu_affinity is refused (this system has no sched_setaffinity): leave it empty"
    except OSError as refused:
        error, used = f" ({refused})", os.sched_getaffinity(0)
    if used == cores:
        return ""
    return (
        f"cpu_affinity '{_listed(cores)}' is refused{error}: the node may use '{_listed(used)}'; "
        f"expected some of this machine's {os.cpu_count()} cores, counted from 0 (a container may allow fewer)"
    )


def lock_memory() -> str:
    """Lock all present and future memory of this process in RAM, so that no cycle waits for a page fault.

    Return "", or one sentence with the reason of the refusal. A finite memlock limit counts as a refusal, because
    the process could exceed it in the middle of a motion.
    """
    reason = _denied_lock()
    if not reason:
        return ""
    return (
        f"lock_memory is refused ({reason}): page faults may delay a cycle; "
        "allow it by memlock unlimited (/etc/security/limits.conf) or CAP_IPC_LOCK, or set lock_memory to false"
    )


def freeze_garbage() -> None:
    """Collect garbage, then exempt all remaining objects from garbage collection.

    Call it after large objects were built: a full collection of a node takes 16 ms before and 4 us after.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()


def _denied_lock() -> str:
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and not _capable(_CAP_IPC_LOCK):
        return f"the memlock limit is {limit // 1024} kB"
    try:
        mlockall = ctypes.CDLL(None, use_errno=True).mlockall
    except (OSError, AttributeError):
        return "this system has no mlockall"
    return os.strerror(ctypes.get_errno()) if mlockall(_MCL_CURRENT | _MCL_FUTURE) else ""


def _capable(capability: int) -> bool:
    """Return True if this process has the Linux capability."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("CapEff:"):
                return bool(int(line.split()[1], 16) >> capability & 1)
    return False


def _schedule(policy: int, priority: int) -> None:
    for thread in _threads():
        with suppress(ProcessLookupError):
            os.sched_setscheduler(thread, policy, os.sched_param(priority))


def _threads() -> list[int]:
    """Return the thread ids of this process; any thread may end at any time."""
    return [int(thread) for thread in os.listdir("/proc/self/task")]


def _present_core() -> int:
    """Return the core on which this process ran last (proc_pid_stat(5))."""
    return int(Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[36])


def _listed(cores: Iterable[int]) -> str:
    return ",".join(str(core) for core in sorted(cores))
