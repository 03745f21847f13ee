# SPDX-License-Identifier: Apache-2.0
"""Process settings are in effect, as read back from the kernel, or their refusal is reported."""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import threading
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from fjr_core import ParameterError
from fjr_core.config.process import ProcessSettings, cores, process_parameters, process_settings
from fjr_msgs_py.node import scheduling
from fjr_msgs_py.node.scheduling import NICE, SLICE, ahead_of_new_threads, prioritised, step_back, take_priority
from fuzzing import refused
from msgs.child import run, run_node

NOBODY = 65534

# Apply the settings while a thread runs; print the refusals and the scheduling of every thread.
TAKE_CARE = """
import ctypes, json, os, resource, sys, threading
from pathlib import Path
from fjr_core.config.process import ProcessSettings
from fjr_msgs_py.node.scheduling import apply_process_settings, slice_of, step_back, yield_to_loops
care, user, memlock, back, refuse = json.loads(sys.argv[1])
def refused(*_):
    raise PermissionError(1, "Operation not permitted")
for name in refuse:
    setattr(os, name, refused)
def wait():
    if back:
        step_back()
    started.set()
    threading.Event().wait()
started = threading.Event()
threading.Thread(target=wait, daemon=True).start()
started.wait()
if memlock is not None:
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (memlock, memlock))
if user is not None:
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    os.setuid(user)
care["cores"] = frozenset(care.get("cores", ()))
for _ in range(2):  # at the start and when the node is configured
    granted, refusals = apply_process_settings(ProcessSettings(**care))
yield_to_loops()
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
threads = sorted((int(thread) for thread in os.listdir("/proc/self/task")), key=os.getpid().__ne__)
print(json.dumps({
    "granted": granted,
    "small pages": ctypes.CDLL(None).prctl(42, 0, 0, 0, 0),  # PR_GET_THP_DISABLE
    "refusals": refusals,
    "slices": [slice_of(t) for t in threads],
    "locked": int(status["VmLck"].split()[0]),
    "policies": [[os.sched_getscheduler(t), os.sched_getparam(t).sched_priority] for t in threads],
    "cores": [sorted(os.sched_getaffinity(t)) for t in threads],
}))
"""

INTERRUPTED = """
    ticks = 0
    def tick(self):
        self.ticks += 1
        if self.ticks == 5:
            os.kill(os.getpid(), signal.SIGINT)
    def stop(self):
        print("last words", self.ticks >= 5, flush=True)
"""
"""Of a node that interrupts itself at the fifth call of its timer."""

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's /proc")
root = pytest.mark.skipif(os.name != "posix" or os.getuid() != 0, reason="only root may become somebody else")


@linux
def test_without_a_priority_every_thread_has_short_slices_on_its_core_and_python_yields() -> None:
    core = max(os.sched_getaffinity(0))
    found = _take_care({"cores": [core]})
    assert found["refusals"] == []
    assert found["policies"] == [[os.SCHED_BATCH, 0], [os.SCHED_OTHER, 0]]
    assert found["cores"] == [[core]] * 2
    _is_said(found)


@linux
def test_the_last_core_is_named_only_where_the_system_grants_it() -> None:
    found = _take_care({"priority": 7}, refuse=("sched_setscheduler", "sched_setaffinity"))
    assert found["cores"] == [sorted(os.sched_getaffinity(0))] * 2
    assert "realtime_priority 7 is refused" in found["refusals"][0]
    assert "rtprio" in found["refusals"][0], "the remedy"
    assert found["granted"].startswith("ordinary scheduling")
    assert "on core" not in found["granted"]


@linux
def test_priority_and_locked_memory_are_in_effect_or_their_refusals_are_reported() -> None:
    """Kernels of PREEMPT_NONE let no thread of a core run for 5 ms while they clear or assemble a huge page."""
    found = _take_care({"priority": 7, "lock_memory": True})
    refused = {sentence.partition(" ")[0] for sentence in found["refusals"]}
    granted = [[os.SCHED_OTHER, 0], [os.SCHED_FIFO, 7]]  # Python, and a thread of the loop
    assert (found["policies"] == granted) == ("realtime_priority" not in refused)
    assert ("real-time priority 7 is granted" in found["granted"]) == ("realtime_priority" not in refused)
    assert (found["locked"] > 1000) == ("lock_memory" not in refused)
    assert found["small pages"] == 1
    cores = sorted(os.sched_getaffinity(0))
    assert found["cores"] == [cores[:-1] or cores, cores[-1:]]  # Python, and a thread of the loop


@linux
def test_threads_that_stepped_back_keep_their_scheduling() -> None:
    assert _take_care({"priority": 1}, back=True)["policies"][1] == [os.SCHED_BATCH, 0]


def _is_said(found: dict[str, Any], where: str = "") -> None:
    """Compare the sentence about ordinary scheduling with the slices of the threads, first the main one."""
    version = tuple(int(part) for part in os.uname().release.split(".")[:2])
    if version >= (6, 12):
        assert found["slices"] == [SLICE] * 2
        assert found["granted"].startswith(f"ordinary scheduling with slices of 0.1 ms{where}: cycles may be late")
    else:
        assert found["granted"].startswith(f"ordinary scheduling{where} (slices of 0.1 ms need Linux")


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


@linux
@pytest.mark.parametrize("refused", ["sched_setscheduler", "sched_setaffinity"])
def test_without_permission_new_threads_are_not_held_back_and_nothing_changes(
    monkeypatch: pytest.MonkeyPatch, refused: str
) -> None:
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    with monkeypatch.context() as patched:
        patched.setattr(os, refused, refuse)
        with ahead_of_new_threads() as ahead:
            assert not ahead
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before


@linux
@pytest.mark.parametrize("there", [True, False])
def test_a_missing_core_is_refused_in_one_sentence(there: bool) -> None:
    allowed = sorted(os.sched_getaffinity(0))
    used = allowed[:1] if there else allowed
    found = _take_care({"cores": [*allowed[:1], 4000] if there else [4000]})
    assert found["cores"] == [used] * 2
    (sentence,) = found["refusals"]
    assert f"cpu_affinity '{f'{allowed[0]},' if there else ''}4000' is refused" in sentence
    assert f"the node may use '{','.join(map(str, used))}'" in sentence
    assert "\n" not in sentence


@linux
@root
def test_an_unprivileged_user_gets_two_sentences_short_slices_and_one_core_for_the_loop() -> None:
    found = _take_care({"priority": 50, "lock_memory": True}, user=NOBODY, memlock=4 << 20)
    assert found["policies"] == [[os.SCHED_BATCH, 0], [os.SCHED_OTHER, 0]]
    cores = sorted(os.sched_getaffinity(0))
    assert found["cores"] == [cores[:-1] or cores, cores[-1:]]  # Python, and a thread of the middleware
    _is_said(found, f" on core {cores[-1]}")
    memory, priority = found["refusals"]
    locked = re.search(r"lock_memory is refused \(the memlock limit is 4096 kB; (\d+) kB of code are locked\)", memory)
    assert locked
    assert 0 < found["locked"] == int(locked[1]) <= 4096
    assert "realtime_priority 50 is refused" in priority


@linux
@root
@pytest.mark.skipif(
    resource.getrlimit(resource.RLIMIT_MEMLOCK)[1] != resource.RLIM_INFINITY, reason="the limit cannot be raised here"
)
def test_a_limit_above_what_is_mapped_locks_that_and_says_so() -> None:
    found = _take_care({"lock_memory": True}, user=NOBODY, memlock=64 << 30)
    assert found["locked"] > 10_000
    assert "memory that is mapped later, beyond the memlock limit of 67108864 kB" in found["refusals"][0]


@linux
def test_what_runs_beside_a_loop_steps_back_alone() -> None:
    with ThreadPoolExecutor(1, initializer=step_back) as worker:
        thread = worker.submit(threading.get_native_id).result()
        assert os.sched_getscheduler(thread) == os.SCHED_BATCH
        assert os.getpriority(os.PRIO_PROCESS, thread) == max(NICE, os.getpriority(os.PRIO_PROCESS, 0))
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


@linux
@pytest.mark.parametrize("refused", [False, True])
def test_a_recorder_has_priority_or_steps_back_during_the_run(monkeypatch: pytest.MonkeyPatch, refused: bool) -> None:
    allowed = not refused and not take_priority(1)
    monkeypatch.setattr(scheduling, "take_priority", take_priority if allowed else lambda *_, **__: "refused")
    with prioritised(1, beside=True):
        inside = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    assert inside == (os.SCHED_FIFO if allowed else os.SCHED_BATCH)
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


@pytest.mark.parametrize("executor", ["events", "single"])
def test_a_signal_ends_either_executor_after_the_last_command_and_a_refusal_is_logged(executor: str) -> None:
    done = run_node(INTERRUPTED, executor=executor, cpu_affinity="4000")
    assert (done.returncode, done.stdout) == (0, "last words True\n")
    (said,) = done.stderr.splitlines()
    assert "cpu_affinity '4000' is refused" in said


@pytest.mark.parametrize(
    ("text", "expected"), [("", set()), ("0,2-3", {0, 2, 3}), ("3-2, 0", {0, 2, 3}), (" 1 , 1", {1})]
)
def test_cores_are_written_as_for_taskset(text: str, expected: set[int]) -> None:
    assert cores(text) == expected


@pytest.mark.parametrize("text", ["-1", "all", "1;2", "1,,2", "1.0", "99999"])
def test_an_invalid_core_list_is_rejected_in_one_sentence(text: str) -> None:
    refused(ParameterError, lambda: cores(text), f"parameter 'cpu_affinity' is '{text}'; expected core numbers")


def test_lock_step_has_no_priority_and_defaults_change_nothing() -> None:
    defaults: dict[str, Any] = {parameter.name: parameter.default for parameter in process_parameters()}
    assert process_settings(defaults) == ProcessSettings()
    assert process_settings({**defaults, "realtime_priority": 50}).priority == 50
    assert process_settings({**defaults, "realtime_priority": 50, "lockstep": True}).priority == 0


def _take_care(
    care: dict[str, Any],
    user: int | None = None,
    memlock: int | None = None,
    back: bool = False,
    refuse: Collection[str] = (),
) -> dict[str, Any]:
    """Return what the child process has after it applied `care`; back: its second thread stepped back.

    refuse: functions of `os` that the system refuses.
    """
    done = run(TAKE_CARE, json.dumps([care, user, memlock, back, refuse]))
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_children_of_a_prioritised_process_have_ordinary_scheduling() -> None:
    """A child process at real-time priority would suspend the running nodes."""
    allowed = not take_priority(1)
    with prioritised(10):
        own = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        child = subprocess.run(
            [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"],
            capture_output=True,
            text=True,
            check=True,
        )
    assert own == (os.SCHED_FIFO if allowed else os.SCHED_OTHER)
    assert int(child.stdout) == os.SCHED_OTHER
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
