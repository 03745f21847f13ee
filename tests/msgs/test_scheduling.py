# SPDX-License-Identifier: Apache-2.0
"""Process settings are in effect, as read back from the kernel, or their refusal is reported."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fjr_core import ParameterError
from fjr_core.config.process import ProcessSettings, cores, process_parameters, process_settings
from fjr_msgs_py.node import scheduling
from fjr_msgs_py.node.scheduling import ahead_of_new_threads, apply_process_settings, prioritised, take_priority
from msgs.child import run

NOBODY = 65534

# Apply the settings while a thread runs; print the refusals and the scheduling of every thread.
TAKE_CARE = """
import json, os, resource, sys, threading
from pathlib import Path
from fjr_core.config.process import ProcessSettings
from fjr_msgs_py.node.scheduling import apply_process_settings
care, user, memlock = json.loads(sys.argv[1])
thread = threading.Thread(target=threading.Event().wait, daemon=True).start()
if memlock is not None:
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (memlock, memlock))
if user is not None:
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    os.setuid(user)
care["cores"] = frozenset(care.get("cores", ()))
refusals = apply_process_settings(ProcessSettings(**care))
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
threads = [int(thread) for thread in os.listdir("/proc/self/task")]
print(json.dumps({
    "refusals": refusals,
    "locked": int(status["VmLck"].split()[0]),
    "policies": [[os.sched_getscheduler(t), os.sched_getparam(t).sched_priority] for t in threads],
    "cores": [sorted(os.sched_getaffinity(t)) for t in threads],
}))
"""

# Run a node by process.run that interrupts itself at the fifth call of its timer.
INTERRUPTED = """
import os, signal, sys
from rclpy.node import Node
from fjr_core.config.process import process_parameters
from fjr_msgs_py.node import process
class Counting(Node):
    def __init__(self):
        super().__init__("counting")
        self.values = {p.name: p.default for p in process_parameters()} | eval(sys.argv[1])
        self.count = 0
        self.create_timer(0.001, self.tick)
    def tick(self):
        self.count += 1
        if self.count == 5:
            os.kill(os.getpid(), signal.SIGINT)
    def stop(self):
        print("last words", self.count >= 5, flush=True)
sys.exit(process.run(Counting))
"""

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's /proc")
root = pytest.mark.skipif(os.name != "posix" or os.getuid() != 0, reason="only root may become somebody else")


def test_zero_leaves_scheduling_and_affinity_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: pytest.fail("asked"))
    monkeypatch.setattr(os, "sched_setaffinity", lambda *_: pytest.fail("asked"))
    assert apply_process_settings(ProcessSettings()) == []


@linux
@pytest.mark.parametrize("refused", ["sched_setscheduler", "sched_setaffinity"])
def test_without_permission_new_threads_are_not_held_back_and_nothing_changes(
    monkeypatch: pytest.MonkeyPatch, refused: str
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    with monkeypatch.context() as patched:
        patched.setattr(os, refused, refuse)
        with ahead_of_new_threads() as ahead:
            assert not ahead
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before


def test_a_refusal_is_one_sentence_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    sentence = take_priority(50)
    assert "realtime_priority 50 is refused" in sentence
    assert "rtprio" in sentence
    assert "\n" not in sentence


@linux
def test_priority_applies_to_running_threads_or_its_refusal_is_reported() -> None:
    found = _take_care({"priority": 7})
    granted = [[os.SCHED_FIFO, 7]] * 2
    assert (found["policies"] == granted) == (found["refusals"] == [])


@linux
def test_memory_is_locked_or_its_refusal_is_reported() -> None:
    found = _take_care({"lock_memory": True})
    assert (found["locked"] > 1000) == (found["refusals"] == [])


@linux
def test_all_threads_stay_on_the_core() -> None:
    core = max(os.sched_getaffinity(0))
    found = _take_care({"cores": [core]})
    assert found["refusals"] == []
    assert found["cores"] == [[core]] * 2


@linux
def test_a_missing_core_is_refused_in_one_sentence() -> None:
    allowed = sorted(os.sched_getaffinity(0))
    found = _take_care({"cores": [4000]})
    assert found["cores"] == [allowed] * 2
    assert len(found["refusals"]) == 1
    assert "cpu_affinity '4000' is refused" in found["refusals"][0]
    assert "\n" not in found["refusals"][0]


@linux
def test_a_partly_missing_set_of_cores_is_reported() -> None:
    core = min(os.sched_getaffinity(0))
    found = _take_care({"cores": [core, 4000]})
    assert found["cores"] == [[core]] * 2
    assert f"the node may use '{core}'" in found["refusals"][0]


@linux
@root
def test_an_unprivileged_user_gets_two_sentences_and_the_node_runs() -> None:
    found = _take_care({"priority": 50, "lock_memory": True}, user=NOBODY, memlock=4 << 20)
    assert found["locked"] == 0
    assert found["policies"] == [[os.SCHED_OTHER, 0]] * 2
    memory, priority = found["refusals"]
    assert "lock_memory is refused (the memlock limit is 4096 kB)" in memory
    assert "realtime_priority 50 is refused" in priority


def test_a_finite_memory_limit_counts_as_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (8 << 30, 8 << 30))
    monkeypatch.setattr(scheduling, "_capable", lambda _: False)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: pytest.fail("asked"))
    assert "memlock limit is 8388608 kB" in scheduling.lock_memory()


@pytest.mark.parametrize("executor", ["events", "single"])
def test_a_signal_ends_either_executor_after_the_last_command(executor: str) -> None:
    done = run(INTERRUPTED, repr({"executor": executor}))
    assert (done.returncode, done.stdout, done.stderr) == (0, "last words True\n", "")


def test_a_refused_setting_is_logged_and_the_node_runs() -> None:
    done = run(INTERRUPTED, repr({"cpu_affinity": "4000"}))
    assert (done.returncode, done.stdout) == (0, "last words True\n")
    assert done.stderr.count("cpu_affinity '4000' is refused") == 1


def test_an_invalid_core_list_ends_the_node_with_one_sentence() -> None:
    done = run(INTERRUPTED, repr({"cpu_affinity": "both"}))
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("cannot start: parameter 'cpu_affinity' is 'both'; expected core numbers")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "expected"), [("", set()), ("1", {1}), ("0,2-3", {0, 2, 3}), ("3-2, 0", {0, 2, 3}), (" 1 , 1", {1})]
)
def test_cores_are_written_as_for_taskset(text: str, expected: set[int]) -> None:
    assert cores(text) == expected


@given(st.frozensets(st.integers(0, 1023), min_size=1))
def test_any_list_of_cores_is_read(wanted: frozenset[int]) -> None:
    assert cores(",".join(str(core) for core in wanted)) == wanted


@pytest.mark.parametrize("text", ["-1", "all", "1;2", "0x1", "1,,2", "1.0", ",", "99999"])
def test_an_invalid_core_list_is_rejected(text: str) -> None:
    with pytest.raises(ParameterError, match="cpu_affinity"):
        cores(text)


def test_lock_step_has_no_priority_and_defaults_change_nothing() -> None:
    defaults: dict[str, Any] = {parameter.name: parameter.default for parameter in process_parameters()}
    assert process_settings(defaults) == ProcessSettings()
    assert process_settings({**defaults, "realtime_priority": 50}).priority == 50
    assert process_settings({**defaults, "realtime_priority": 50, "lockstep": True}).priority == 0


def _take_care(care: dict[str, Any], user: int | None = None, memlock: int | None = None) -> dict[str, Any]:
    done = run(TAKE_CARE, json.dumps([care, user, memlock]))
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
