# SPDX-License-Identifier: Apache-2.0
"""Run plant and controller as processes under an independent watcher, for faults to be injected during the motion."""

from __future__ import annotations

import gc
import math
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import yaml
from ament_index_python.packages import get_package_share_directory

from faults.measures import THRESHOLD, Anchor, Motion, Sine
from faults.peers import (
    COMMANDS,
    DIAGNOSTICS,
    EFFORTS,
    REFERENCE,
    STATES,
    TRUE_STATES,
    Heard,
    Relay,
    Remote,
    Tamper,
    Watcher,
)
from fjr_core.config import ros_yaml
from fjr_msgs_py.node.scheduling import prioritised
from fjr_plant.lock_step import START as LOCKSTEP_START
from system.executables import NODES, Executable, installed, scenario
from time_limits import Limit

LIMIT = 40.0  # s on an idle machine; a longer wait for an event is a failure
LOOK = 0.005  # s between polls of the queues
SECOND = 10**9  # ns
PRIORITY = 10  # of watcher and relay, if the system allows it: below the nodes, above all others
CALM = 3 * SECOND // 10  # ns of small error until a motion counts as recovered
LOOK_AHEAD = SECOND // 10
PROFILE = Path(get_package_share_directory("fjr_bringup"), "config", "fastdds.xml")
WITHOUT_SHARED_MEMORY = {
    "FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("fastdds.xml")),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
}
"""Environment of the nodes, which keeps them from waiting for a process that joins; see the profile."""


DIRECT, RELAYED, STEPPED = "direct", "relayed", "stepped"
"""Modes of the pair: real time, real time with a relay in between, or lock-step."""
NOTHING: Mapping[str, Mapping[str, Any]] = {}
STEPS = {"plant": {"lockstep": True, "start_paused": True}, "controller": {"use_sim_time": True}}


@dataclass(frozen=True)
class Setting:
    """A scenario with additional parameters of each node, by dotted names.

    limit (n,): effort limits [N m]. full_motion [s]: reference time of high speed; again [s]: time until the next.
    """

    scenario: str
    limit: tuple[float, ...]
    full_motion: float
    again: float
    plant: Mapping[str, Any] = field(default_factory=dict)
    controller: Mapping[str, Any] = field(default_factory=dict)

    def document(self, more: Mapping[str, Mapping[str, Any]] = NOTHING) -> dict[str, Any]:
        """Return the parameter file of the scenario with these parameters and `more` for each node."""
        document: dict[str, Any] = yaml.safe_load(Path(scenario(self.scenario)).read_text())
        for node in NODES:
            own = {**getattr(self, node), **more.get(node, {})}
            document[f"/**/fjr_{node}"] = {"ros__parameters": ros_yaml.tree_of(own)}
        return document

    def parameters(self, node: str) -> dict[str, Any]:
        """Return the parameters of a node and of all nodes, by dotted names."""
        return ros_yaml.values_for(f"fjr_{node}", self.document())

    @property
    def reference(self) -> Sine:
        values = self.parameters("controller")
        return Sine(*(np.array(values[f"reference.{k}"]) for k in ("amplitude", "frequency", "offset", "phase")))


class Rig:
    """A watched pair of nodes; close() leaves no process behind. executor: of both nodes, "" for their default."""

    def __init__(self, setting: Setting, mode: str, executor: str = "") -> None:
        self._environment = mock.patch.dict(os.environ, {"FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE)})
        self._environment.start()
        self.setting = setting
        self._executor = ("-p", f"executor:={executor}") if executor else ()
        self.watcher = Watcher()
        self.mode = mode
        self.truth = TRUE_STATES if mode == RELAYED else STATES
        self.relay = Relay(TRUE_STATES, STATES) if mode == RELAYED else None
        self.remote = Remote()
        self.anchors: list[Anchor] = []
        self._folder = tempfile.TemporaryDirectory(prefix="fjr-faults-")
        self._file = Path(self._folder.name, "scenario.yaml")
        self._file.write_text(yaml.safe_dump(setting.document(STEPS if mode == STEPPED else NOTHING)))
        self._steps = 0
        self._cleanup = ExitStack()
        self._cleanup.callback(gc.enable)
        gc.disable()  # a collection in a large test process would stop the relay beyond state_timeout
        self._period = round(SECOND / setting.parameters("plant")["publish_rate"])
        self.started: dict[str, int] = {}  # times [ns] of the last start and kill
        self.killed: dict[str, int] = {}
        self._running: dict[str, Executable] = {}
        self._ended: list[Executable] = []

    def start(self, node: str, *arguments: str, key: str = "") -> str:
        """Start "plant" or "controller" and return its key; `key` names another process of the same kind."""
        remaps = ["-r", f"joint_states:={TRUE_STATES}"] if self.relay and node == "plant" else []
        words = ("--ros-args", "--params-file", str(self._file), *remaps, *self._executor, *arguments)
        self.started[key or node] = time.time_ns()
        self._running[key or node] = Executable(installed(node, *words), **WITHOUT_SHARED_MEMORY)
        return key or node

    def start_both(self) -> None:
        """Start both nodes; return when the arm is moving to the reference."""
        self.start("controller")
        self.until(lambda: all(map(self.watcher.senders, (EFFORTS, COMMANDS, REFERENCE))), "the controller")
        self.start("plant")
        self.until(lambda: self.watcher.senders(self.truth), "the plant")
        self._cleanup.enter_context(prioritised(PRIORITY))
        if self.mode == STEPPED:
            self._step(1)
            self._step(round(self.setting.parameters("controller")["start.join_time"] * SECOND / self._period))
        self.anchor_in_reference(0)
        if self.mode != STEPPED:  # robot time is unknown until the plant is connected to the watcher
            self.until(lambda: self.now >= self.anchors[-1].begin, "a state of the robot")

    def anchor_in_reference(self, sent: int) -> int:
        """Determine time 0 of the reference from messages sent after `sent` [ns]; return the first stamp [ns].

        The very first message may be missed, because its publisher may not be connected to the watcher yet.
        """
        sine = self.setting.reference
        first = self.first(REFERENCE, lambda heard: heard.sent >= sent, "the first answer").stamp
        joined = self.first(
            REFERENCE, lambda heard: heard.sent >= sent and sine.holds(*_of_first_joint(heard)), "the end of the join"
        )
        self.anchor(joined.stamp - sine.time(*_of_first_joint(joined)), first)
        return first

    def kill(self, node: str) -> None:
        """Kill a node by SIGKILL."""
        executable = self._running.pop(node)
        self.killed[node] = time.time_ns()
        executable.signal(signal.SIGKILL)
        executable.process.wait()
        self._ended.append(executable)

    def ended(self, key: str) -> tuple[int, str]:
        """Wait until a process ends by itself; return exit code and output."""
        executable = self._running.pop(key)
        self._ended.append(executable)
        self.until(lambda: executable.process.poll() is not None, f"the end of {key}")
        return executable.end()

    @property
    def now(self) -> int:
        """Return the newest true stamp of the robot [ns], 0 before the first."""
        self.watcher.look()
        heard = self.watcher.heard[self.truth]
        return heard[-1].stamp if heard else 0

    def anchor(self, zero: int, begin: int) -> None:
        """Set the desired motion from the true stamp `begin` on to the reference at stamp - zero [ns]."""
        self.anchors.append(Anchor(begin, zero))

    def until(self, happened: Callable[[], Any], what: str) -> None:
        """Poll until `happened()` is true; fail if a node ends or the wait is too long."""
        limit = Limit(LIMIT)
        pause = threading.Event()
        self.watcher.look()
        while not happened():
            assert not limit.passed(), f"{what} did not come within {LIMIT:g} s\n{self.words()}"
            for name, executable in self._running.items():
                assert executable.process.poll() is None, f"{name} has ended\n{self.words()}"
            pause.wait(LOOK)
            self.remote.work()
            self.watcher.look()

    @property
    def full_motion(self) -> int:
        """Return the true stamp [ns] of the next time of high reference speed."""
        period = round(self.setting.again * SECOND)
        first = self.anchors[-1].zero + round(self.setting.full_motion * SECOND)
        return first + max(0, math.ceil((self.robot_time - first) / period)) * period

    def until_full_motion(self) -> int:
        """Wait until full motion; return its stamp [ns]."""
        stamp = self.full_motion
        self.until_stamp(stamp)
        return stamp

    def first_stamp_from(self, stamp: int) -> int:
        """Return the first true stamp at or after another [ns]."""
        return self.first(self.truth, lambda heard: heard.stamp >= stamp, f"a state stamped {stamp}").stamp

    def until_stamp(self, stamp: int) -> None:
        """Wait until robot time is `stamp` [ns]; advance it in lock-step."""
        if self.mode == STEPPED:
            self._step(math.ceil((stamp - self.robot_time) / self._period))
        else:
            self.until(lambda: self.now >= stamp, f"a state stamped {stamp}")

    @property
    def robot_time(self) -> int:
        """Return robot time as a stamp [ns]; its states may still be in transit."""
        if self.mode != STEPPED:
            return self.now
        return LOCKSTEP_START + self._steps * self._period

    def until_calm(self, limit: float) -> None:
        """Wait until the error has been small for CALM, at most `limit` seconds of robot time."""
        end = self.robot_time + round(limit * SECOND)
        while not self.calm and self.robot_time < end:
            self.until_stamp(self.robot_time + LOOK_AHEAD)

    @property
    def calm(self) -> bool:
        """True if the error has been small for CALM."""
        newest = self.now
        tail = [h for h in self.watcher.heard[self.truth][-2000:] if h.stamp > newest - CALM]
        motion = self._motion(tail)
        return newest - int(motion.stamps[0]) > 0.9 * CALM and bool(np.all(motion.error < THRESHOLD))

    def _step(self, samples: int) -> None:
        """Advance robot time by a number of samples."""
        if samples > 0:
            future = self.remote.advance(samples)
            self.until(future.done, f"{samples} samples")
            assert future.result().success, future.result().message
            self._steps += samples

    def tamper(self, begin: int, seconds: float, how: Tamper) -> int:
        """Modify messages in the relay from the stamp `begin` [ns] on, wait for the end, and return its stamp [ns]."""
        assert self.relay
        end = begin + round(seconds * SECOND)
        self.relay.tamper(begin, end, how)
        self.until_stamp(end)
        return end

    def first(self, topic: str, fits: Callable[[Heard], bool], what: str) -> Heard:
        """Wait for the first message of a topic that satisfies `fits`."""
        found: list[Heard] = []
        seen = 0

        def happened() -> bool:
            nonlocal seen
            new = self.watcher.heard[topic][seen:]
            seen += len(new)
            found.extend(heard for heard in new if fits(heard))
            return bool(found)

        self.until(happened, what)
        return found[0]

    def last_report(self, node: str) -> Mapping[str, int]:
        """Return the counters in the next report of the node."""
        sent = time.time_ns()
        name = f"fjr_{node}"
        if self.mode == STEPPED:  # reports follow the stamps in lock-step
            self.until_stamp(self.robot_time + SECOND)
        self.first(DIAGNOSTICS, lambda h: h.sent >= sent and h.message().status[0].name.endswith(name), "a report")
        return self.watcher.counters(name)

    def words(self) -> str:
        """Return the output of the nodes."""
        return "\n".join(f"{name} says:\n{executable.said_so_far()}" for name, executable in self._running.items())

    def motion(self) -> Motion:
        """Return the motion of the arm so far."""
        self.watcher.look()
        return self._motion(self.watcher.heard[self.truth])

    def _motion(self, states: list[Heard]) -> Motion:
        joints = len(self.setting.reference.amplitude)
        q_l = np.array([heard.message().position[:joints] for heard in states])
        stamps = np.array([heard.stamp for heard in states])
        return Motion(stamps, q_l, tuple(self.anchors), self.setting.reference)

    def forget(self) -> None:
        """Leave what was heard so far out of all that follows, but for the newest message of each topic."""
        for heard in self.watcher.heard.values():
            del heard[:-1]

    def efforts(self) -> list[list[float]]:
        """Return all efforts sent on both topics."""
        self.watcher.look()
        plain = [list(message.data) for message in self.watcher.messages(EFFORTS)]
        return plain + [list(message.effort) for message in self.watcher.messages(COMMANDS)]

    def close(self) -> None:
        """End the nodes and all that watched them."""
        self._cleanup.close()
        for executable in (*self._running.values(), *self._ended):
            executable.kill()
        if self.relay:
            self.relay.close()
        self.remote.close()
        self.watcher.close()
        self._environment.stop()
        self._folder.cleanup()


def _of_first_joint(heard: Heard) -> tuple[float, float]:
    message = heard.message()
    return message.position[0], message.velocity[0]
