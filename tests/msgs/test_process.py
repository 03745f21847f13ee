# SPDX-License-Identifier: Apache-2.0
"""The process of a node: what it does before ROS 2 is loaded, its last command, and its end; on both executors."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from rclpy.duration import Duration
from rclpy.node import Node

from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.node import process
from fjr_msgs_py.node.loading import ament_index_of_wheels, middleware_of_wheels
from fjr_msgs_py.node.reports import Health
from msgs.child import run, run_node
from nodes.harness import Ros
from time_limits import HANG

FALLING = """
        self.calls = []
        self.create_subscription(Empty, "fall", self.fall, 1)
        self.create_service(Trigger, "fall", self.fall)
        self.publisher = self.create_publisher(Empty, "fall", 1)
        self.client = self.create_client(Trigger, "fall")
    def tick(self):
        self.calls.append("tick")
        if len(self.calls) == 5:
            getattr(self, sys.argv[2])()
    def subscription(self):
        self.publisher.publish(Empty())
    def service(self):
        self.client.call_async(Trigger.Request())
    def fall(self, *_):
        self.timer()
    def timer(self):
        self.calls.append("fell")
        raise FjrError("it fell")
    def surprise(self):
        raise RuntimeError("nobody thought of it")
    def stop(self):
        print("last words", "fell" in self.calls, self.calls[-1], flush=True)
"""
"""Of a node whose fifth tick does what its argument says."""

REBUILT = """
        self.built()  # not in a process yet: nobody cares
    def tick(self):
        before = gc.get_freeze_count()
        self.large = [[k] for k in range(100_000)]
        core = max(os.sched_getaffinity(0))
        self.values = {**self.values, "cpu_affinity": str(core)}
        self.built()
        print(gc.get_freeze_count() - before > 90_000, os.sched_getaffinity(0) == {core})
        self.end(FjrError("enough"))
        print(gc.isenabled())
    def stop(self):
        pass
gc.disable()
"""
"""Of a node that starts without garbage collection, changes its process settings after a rebuild, and ends."""

CYCLE = """
        gc.set_threshold(0)
        self.cycle = None
    def tick(self):
        if self.cycle is None:
            made = Cycle()
            made.itself, self.cycle = made, weakref.ref(made)
        elif self.cycle() is None:
            os.kill(os.getpid(), signal.SIGTERM)
    def stop(self):
        print("spins", spins, flush=True)
class Cycle:
    pass
spins = 0
def counting(kind):
    def make():
        executor = kind()
        class Counting:
            def __getattr__(self, name):
                global spins
                spins += name == "spin_until_future_complete"
                return getattr(executor, name)
        return Counting()
    return make
process.COLLECTION = 0.01
process.EventsExecutor = counting(process.EventsExecutor)
"""
"""Of a node that makes a reference cycle, which no automatic collection frees, and ends when it is gone."""


@pytest.mark.parametrize(
    ("executor", "where"), [("events", "subscription"), ("events", "service"), ("single", "timer")]
)
def test_an_fjr_error_ends_the_process_with_one_sentence(executor: str, where: str) -> None:
    done = run_node(FALLING, where, executor=executor)
    assert done.stderr == "ended: it fell\n"
    assert done.stdout == "last words True fell\n", "no callback may run after it"
    assert done.returncode == 1


def test_an_unexpected_exception_is_a_traceback_after_the_last_command() -> None:
    done = run_node(FALLING, "surprise", executor="events")
    assert done.stdout == "last words False tick\n"
    assert done.stderr.rstrip().endswith("RuntimeError: nobody thought of it")
    assert "Traceback" in done.stderr
    assert done.returncode == 1


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for the cores")
def test_process_settings_are_applied_again_after_a_rebuild_and_garbage_is_collected() -> None:
    done = run_node(REBUILT)
    assert (done.returncode, done.stdout) == (1, "True True\nTrue\n")
    said, end = done.stderr.splitlines()  # what was granted is said once
    assert " scheduling" in said
    assert end == "ended: enough"


@pytest.mark.parametrize("executor", ["events", "single"])
def test_garbage_is_collected_regularly_while_the_node_runs_and_the_events_executor_is_entered_once(
    executor: str,
) -> None:
    done = run_node(CYCLE, executor=executor)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"spins {int(executor == 'events')}\n", "")


# The child prints whether it leads a session, then ends as the argument says; the parent prints the exit code it got.
OWN_SESSION = """
import os, signal, sys
from fjr_msgs_py.console.ending import in_own_session
code = in_own_session()
if code is None:
    print(os.getsid(0) == os.getpid(), flush=True)
    eval(sys.argv[1])
print(code)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sessions share the cores on Linux")
@pytest.mark.parametrize(
    ("ends", "code"),
    [
        ("sys.exit(3)", 3),
        ("os.kill(os.getpid(), signal.SIGKILL)", 128 + 9),
        ("signal.pthread_sigmask(0, [15]), os.kill(os.getppid(), 15), sys.exit(signal.sigwait([15]))", 15),  # passed on
    ],
)
def test_the_end_of_a_process_in_its_own_session_is_that_of_the_command(ends: str, code: int) -> None:
    done = run(OWN_SESSION, ends)
    assert done.stdout == f"True\n{code}\n"
    assert done.stderr == ("fjr: the recorder was ended by SIGKILL\n" if code == 128 + 9 else "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_sets_the_event_where_the_main_thread_holds_its_lock(number: signal.Signals) -> None:
    """The lock is held for a part of each `wait`: half of the signals during a loop of waits would end nothing."""
    before = signal.getsignal(number)
    with stoppable() as stop:
        with stop._cond:
            os.kill(os.getpid(), number)
            assert signal.getsignal(number) is not before  # by now Python has called the handler
        assert stop.wait(HANG)
    assert signal.getsignal(number) is before


def test_without_a_signal_nothing_is_set_and_no_thread_stays() -> None:
    with stoppable() as stop:
        assert "signals" in [each.name for each in threading.enumerate()]
    for each in threading.enumerate():
        if each.name == "signals":
            each.join(HANG)
            assert not each.is_alive()
    assert not stop.is_set()


# Before ROS 2 is loaded.


def test_the_loading_module_imports_no_heavy_package() -> None:
    code = "import sys, fjr_msgs_py.node.loading, fjr_plant.executable, fjr_controller.executable; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"rclpy", "numpy", "casadi", "fjr_core"} & set(modules)


def test_what_is_loaded_meanwhile_is_exempt_from_garbage_collection() -> None:
    code = """
import gc
from fjr_msgs_py.node.loading import prepare, resume_garbage_collection
prepare("loading")
paused = not gc.isenabled()
import json
resume_garbage_collection()
print(paused, gc.isenabled(), gc.is_tracked(json.__dict__), any(held is json for held in gc.get_objects()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True True True False\n"


@pytest.mark.parametrize(("before", "after"), [("", "{here}"), ("/ros:/own", "/ros:/own:{here}")])
def test_packages_installed_as_wheels_come_last_in_the_ament_index(
    before: str, after: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", before)
    ament_index_of_wheels()
    assert os.environ["AMENT_PREFIX_PATH"] == before, "nothing is installed yet"
    packages = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    packages.mkdir(parents=True)
    (packages / "fjr_msgs_py").touch()
    for _ in range(2):
        ament_index_of_wheels()
    assert os.environ["AMENT_PREFIX_PATH"] == after.format(here=tmp_path)


def test_a_middleware_that_the_wheels_lack_is_replaced_in_a_sentence_and_one_elsewhere_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    middleware_of_wheels("fjr")
    assert os.environ["RMW_IMPLEMENTATION"] == "rmw_cyclonedds_cpp", "a sourced ROS 2 is elsewhere"
    packages = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    packages.mkdir(parents=True)
    (packages / "rmw_fastrtps_cpp").touch()
    for _ in range(2):
        middleware_of_wheels("fjr")
        assert os.environ["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
    said = capsys.readouterr().err
    assert said == "fjr: RMW_IMPLEMENTATION is rmw_cyclonedds_cpp, which is not installed; rmw_fastrtps_cpp is used\n"


# Counters in the log.


@pytest.fixture
def health(ros: Ros) -> Health:
    return Health(ros.add(Node("healthy", context=ros.context)), ("messages",))


@pytest.mark.parametrize(("level", "word"), [("warn", "[WARN]"), ("error", "[ERROR]")])
def test_an_event_is_logged_once_at_its_level(health: Health, capfd: pytest.CaptureFixture[str], level, word) -> None:
    for _ in range(3):
        health.note(level, "falls", "it fell")
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "it fell" in line]
    assert line.startswith(word)
    assert health.count["falls"] == 3


def test_waiting_for_acknowledgements_takes_its_time_once_for_all_publishers() -> None:
    """A subscriber that was killed never acknowledges: every publisher to it waits as long as it may."""
    waited = []

    class ToTheDead:
        def wait_for_all_acked(self, timeout: Duration) -> bool:
            waited.append(timeout.nanoseconds * 1e-9)
            time.sleep(waited[-1])
            return False

    process.flush(*(ToTheDead() for _ in range(3)), seconds=0.05)
    assert waited[0] <= 0.05
    assert waited[1:] == [0.0, 0.0]
