# SPDX-License-Identifier: Apache-2.0
"""Real-time settings of a process: priority, locked memory, cores, garbage collector.

A setting that the system refuses is reported in one sentence and never raises: the node runs without it.
This module imports neither NumPy nor CasADi.
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import resource
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from fjr_core.config.process import ProcessSettings

SLICE = 100_000  # ns; the shortest slice that Linux grants
NICE = 5  # of threads and processes beside a loop
PYTHON = -10  # nice value of Python beside a real-time loop
LATE = "cycles may be late while more programs are busy than there are cores"
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # sys/mman.h of Linux
_PR_SET_THP_DISABLE = 41  # linux/prctl.h
_CAP_IPC_LOCK = 14  # linux/capability.h
_SYSTEM_CALLS = {"x86_64": (314, 315), "aarch64": (274, 275)}
"""Numbers of sched_setattr and sched_getattr by machine."""
_CODE = ("/fjr/", "librcl.so", "librmw", "libfastcdr", "libc.so", "libm.so", "libstdc++", "libfastrtps")
"""Parts of the paths of the code that a native loop runs, the most important first."""


class _Attributes(ctypes.Structure):
    """struct sched_attr of Linux."""

    _fields_: ClassVar = [
        *((name, ctypes.c_uint32) for name in ("size", "policy")),
        ("flags", ctypes.c_uint64),
        *(("nice", ctypes.c_int32), ("priority", ctypes.c_uint32)),
        *((name, ctypes.c_uint64) for name in ("runtime", "deadline", "period")),
    ]


def apply_process_settings(settings: ProcessSettings) -> tuple[str, list[str]]:
    """Apply the settings to this process: its threads have the priority or short slices, on one core.

    Return a sentence about the scheduling that the system granted, and one for each setting that it refused.
    """
    refuse_huge_pages()
    cores = use_cores(settings.cores)
    refused = take_priority(settings.priority)
    slices = take_short_slices()
    core = keep_to_last_core() if settings.priority else None
    where = "" if core is None else f" on core {core}"
    if os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR):
        priority = os.sched_getparam(0).sched_priority
        granted = f"real-time priority {priority} is granted: other programs do not delay a cycle"
    elif slices:
        granted = f"ordinary scheduling with slices of {slices * 1e-6:g} ms{where}: {LATE}"
    else:
        granted = f"ordinary scheduling{where} (slices of {SLICE * 1e-6:g} ms need Linux 6.12): {LATE}"
    memory = lock_memory() if settings.lock_memory else ""
    return granted, [each for each in (cores, memory, refused) if each]


def take_priority(priority: int, inherited: bool = True) -> str:
    """Schedule the threads of this process as SCHED_FIFO at `priority`; 0 leaves the scheduling unchanged.

    Threads that stepped back stay as they are. inherited: threads and processes started later have the priority, too.
    Return "", or one sentence with the reason of the refusal.
    """
    if priority == 0:
        return ""
    try:
        for thread in _threads():
            with suppress(ProcessLookupError):
                if os.sched_getscheduler(thread) != os.SCHED_BATCH:
                    policy = os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK)
                    os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except (OSError, AttributeError) as error:
        return (
            f"realtime_priority {priority} is refused ({error}): the process has ordinary scheduling; "
            "allow it by an rtprio limit (/etc/security/limits.conf) or CAP_SYS_NICE, or set realtime_priority to 0"
        )
    return ""


def refuse_huge_pages() -> None:
    """Let the memory of this process consist of small pages.

    A kernel that is not preemptible clears and assembles the huge pages that NumPy asks for in steps of 5 ms, in which
    no thread of that core runs.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_THP_DISABLE, 1, 0, 0, 0)


def take_short_slices() -> int:
    """Ask for slices of SLICE for every thread with ordinary scheduling; return what this one has [ns], 0: none.

    A thread that wakes up then preempts others sooner. Linux grants it to every user from 6.12 on.
    """
    for thread in _threads():
        with suppress(OSError, AttributeError):
            if _policy(thread) == os.SCHED_OTHER:
                _ask_for_slice(thread, os.SCHED_OTHER)
    return slice_of(0)


def keep_to_last_core() -> int | None:
    """Confine the other threads of loop and middleware to the last core of this process, and this one to the rest.

    Return that core; None if the system refuses it. The calling thread is Python's.

    Linux divides the share of a session (its autogroup) among the cores by the load on each. A loop that changes its
    core, or whose middleware runs on another, meets cores on which its session has next to no share, and waits there
    for up to 0.1 s while other sessions are busy. On one core the session keeps its share. The native loop does the
    same (loop.c). A real-time thread that wakes on a core in a system call of another program waits for
    its end if the kernel is not preemptible, for up to 4 ms, although the other core is idle: one core meets that less.
    """
    cores: set[int] = set()
    try:
        for thread in _threads():
            with suppress(ProcessLookupError):  # the thread has ended
                cores |= os.sched_getaffinity(thread)
        core = max(cores)
        os.sched_setaffinity(0, cores - {core} or cores)
        for thread in set(_threads()) - {threading.get_native_id()}:
            with suppress(ProcessLookupError):
                if _policy(thread) in (os.SCHED_OTHER, os.SCHED_FIFO):
                    os.sched_setaffinity(thread, {core})
    except (OSError, AttributeError):
        return None
    return core


def slice_of(thread: int) -> int:
    """Return the slice [ns] that a thread with ordinary scheduling asked for; 0 if it is not known."""
    found, call = _Attributes(), _SYSTEM_CALLS.get(platform.machine())
    if call is None or _system_call(call[1], thread, ctypes.byref(found), ctypes.sizeof(found), 0):
        return 0
    return int(found.runtime) if found.policy in (os.SCHED_OTHER, os.SCHED_BATCH) else 0


def step_back(nice: int = NICE) -> None:
    """Let the calling thread, and threads and processes that it starts, yield to loops: SCHED_BATCH, and `nice`.

    A thread of this policy never preempts another when it wakes up. Its slices are short, so that it gets its core back
    soon if it holds a lock for which a loop waits. Every user may ask for it, and no user without privileges may lower
    `nice` again.
    """
    with suppress(OSError, AttributeError):
        thread = threading.get_native_id()
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        _ask_for_slice(thread, os.SCHED_BATCH)
        os.setpriority(os.PRIO_PROCESS, thread, max(nice, os.getpriority(os.PRIO_PROCESS, thread)))


def yield_to_loops() -> None:
    """Let the calling thread yield to the native loop and the middleware, which never wait for Python.

    Beside a real-time loop it has ordinary scheduling and, if that is granted, a nice value of PYTHON: at a real-time
    priority a long call of Python would suspend another process that holds a lock of Fast DDS's shared memory, and the
    loop would wait for both.
    """
    if _policy(0) != os.SCHED_FIFO:
        step_back(0)
        return
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), PYTHON)


@contextmanager
def prioritised(priority: int, beside: bool = False) -> Iterator[None]:
    """Schedule this process as SCHED_FIFO inside the block if the system allows it; beside: else as SCHED_BATCH.

    Child processes and threads started inside the block do not inherit the priority: a process that loads at this
    priority takes a whole core, and the kernel then suspends all real-time threads on it, those of running nodes
    included, for 50 ms of each second (kernel.sched_rt_runtime_us).
    """
    granted = priority > 0 and not take_priority(priority, inherited=False)
    if beside and not granted:
        _schedule(os.SCHED_BATCH)
        for thread in _threads():
            _ask_for_slice(thread, os.SCHED_BATCH)
    try:
        yield
    finally:
        if beside or granted:
            try:
                _schedule(os.SCHED_OTHER)
            except PermissionError:  # only a privileged process may clear SCHED_RESET_ON_FORK
                _schedule(os.SCHED_OTHER | os.SCHED_RESET_ON_FORK)


@contextmanager
def ahead_of_new_threads() -> Iterator[bool]:
    """Let threads that are started inside the block wait until this one sleeps or leaves it; yield False if refused.

    This thread runs as SCHED_FIFO on its present core, to which new threads are confined, too. Use it for milliseconds.
    """
    try:
        cores, policy, setting = os.sched_getaffinity(0), os.sched_getscheduler(0), os.sched_getparam(0)
        ran_on = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[36]  # proc_pid_stat(5)
        os.sched_setaffinity(0, {int(ran_on)})
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
    except AttributeError:
        return "cpu_affinity is refused (this system has no sched_setaffinity): leave it empty"
    except OSError as refused:
        error = f" ({refused})"
    if (used := os.sched_getaffinity(0)) == cores:
        return ""
    return (
        f"cpu_affinity '{_listed(cores)}' is refused{error}: the node may use '{_listed(used)}'; "
        f"expected some of this machine's {os.cpu_count()} cores, counted from 0 (a container may allow fewer)"
    )


def lock_memory() -> str:
    """Lock all present and future memory of this process in RAM, so that no cycle waits for a page fault.

    Under a finite memlock limit lock what is mapped now; if that is too much, the code of the loop as far as it fits.
    Future memory then stays unlocked, because the system would deny it beyond the limit in the middle of a motion.
    Return "", or one sentence with the reason of a complete or partial refusal.
    """
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    try:
        unlimited = limit == resource.RLIM_INFINITY or _capable(_CAP_IPC_LOCK)
        c = ctypes.CDLL(None, use_errno=True)
        if not c.mlockall(_MCL_CURRENT | (_MCL_FUTURE if unlimited else 0)):
            reason = "" if unlimited else f"memory that is mapped later, beyond the memlock limit of {limit // 1024} kB"
        elif unlimited:
            reason = os.strerror(ctypes.get_errno())
        else:
            reason = f"the memlock limit is {limit // 1024} kB; {_lock_code(c, limit) // 1024} kB of code are locked"
    except (OSError, AttributeError):
        reason = "this system has no mlockall"
    if not reason:
        return ""
    return (
        f"lock_memory is refused ({reason}): page faults may delay a cycle; "
        "allow it by memlock unlimited (/etc/security/limits.conf) or CAP_IPC_LOCK, or set lock_memory to false"
    )


def _lock_code(c: ctypes.CDLL, limit: int) -> int:
    """Lock code that the loop runs, its own first, then that of the middleware; return the number of locked bytes."""
    mapped = [line.split() for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()]
    code = [(each[0], each[5]) for each in mapped if len(each) > 5 and "x" in each[1]]
    ranked = [(rank, area) for area, path in code for rank, part in enumerate(_CODE) if part in path]
    locked = 0
    for _, area in sorted(ranked):
        begin, end = (int(address, 16) for address in area.split("-"))
        if locked + end - begin <= limit and not c.mlock(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin)):
            locked += end - begin
    return locked


def freeze_garbage() -> None:
    """Collect garbage, then exempt all remaining objects from garbage collection.

    Call it after large objects were built: a full collection of a node takes 16 ms before and 4 us after.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()


def _capable(capability: int) -> bool:
    """Return True if this process has the Linux capability."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    found = status.partition("CapEff:")[2].split()
    return bool(found and int(found[0], 16) >> capability & 1)


def _policy(thread: int) -> int:
    """Return the scheduling policy of a thread; 0: the calling one."""
    return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK


def _schedule(policy: int) -> None:
    """Give all threads a policy without priorities."""
    for thread in _threads():
        with suppress(ProcessLookupError):
            os.sched_setscheduler(thread, policy, os.sched_param(0))


def _ask_for_slice(thread: int, policy: int) -> None:
    call, nice = _SYSTEM_CALLS.get(platform.machine()), os.getpriority(os.PRIO_PROCESS, thread)
    attributes = _Attributes(ctypes.sizeof(_Attributes), policy, 0, nice, 0, SLICE, 0, 0)
    if call is not None:
        _system_call(call[0], thread, ctypes.byref(attributes), 0)


def _system_call(number: int, *arguments: Any) -> int:
    return int(ctypes.CDLL(None, use_errno=True).syscall(number, *arguments))


def _threads() -> list[int]:
    """Return the thread ids of this process; any thread may end at any time."""
    return [int(thread) for thread in os.listdir("/proc/self/task")]


def _listed(cores: Iterable[int]) -> str:
    return ",".join(str(core) for core in sorted(cores))
