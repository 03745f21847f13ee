# SPDX-License-Identifier: Apache-2.0
"""Efforts of a recorded sequence from each host of the control step.

In Python, in a study, in exported C, in ros2_control, and in running nodes, in rclpy and in a native thread.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from design.exports.c_program import C99, built
from design.exports.ros2_control import exported_package
from fjr_controller.controller_node import ControllerNode
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.jit import CLibrary
from fjr_core.runtime.events import KINDS
from fjr_core.runtime.library import Model, settings_struct, step_library
from fjr_core.runtime.reference import ReferenceStruct
from fjr_design.batch import scenario_loop
from fjr_design.exports.project import export, write
from fjr_msgs_py import names
from fjr_msgs_py.node.participant import leave
from hosts.inputs import Input, Kind, Sequence
from nodes.harness import EventsExecutor, subscriptions
from time_limits import HANG, Limit

Efforts = NDArray[np.float64]
HERE = Path(__file__).parent
CONTROLLER = tuple(name for name in exported_package.SOURCES if name != "elastic_arm")
SAMPLES = 2  # of the recorded case, which is not used here


class Replay(NamedTuple):
    """Efforts (k, n) that were sent, their number after each input, and the counters of the controller by name."""

    efforts: Efforts
    counts: list[int]
    counters: dict[str, int]


def reference_replay(sequence: Sequence, repeats: bool = True) -> Replay:
    """Replay the inputs in the control step in Python; repeats: states with the stamp of the last one arrive."""
    step = sequence.scenario.control_step(sequence.simulated)
    first = bytes(step.ffi.buffer(step.controller))

    def restart() -> None:
        step.ffi.memmove(step.controller, first, len(first))

    host = _Host(step.ffi, step.lib, step.model, step.controller, restart, changes(step.library, sequence))
    return host.replay(sequence, repeats)


def study_efforts(sequence: Sequence) -> Efforts:
    """Return all efforts (k, n) that the step of the compiled loop of a study sends."""
    s = sequence.scenario
    law, loop = s.sampled_law, scenario_loop(s, s.sampled_law, duration=2.0)
    ffi, lib, _ = loop.library
    model = Model(loop.library, law, loop.model_functions, s.observer, s.measurement, sequence.simulated)
    reference, gains = ReferenceStruct(ffi, s.reference), np.ascontiguousarray(law.gain_values, dtype=float)
    written = settings_struct(loop.library, s.settings, law)
    controller = ffi.new("struct fjr_controller *")

    def restart() -> None:
        lib.fjr_init(controller, written, ffi.cast("double *", gains.ctypes.data), reference.pointer)

    restart()
    changed = changes(loop.library, sequence)
    return _Host(ffi, lib, model.pointer, controller, restart, changed).replay(sequence).efforts


class Changes(NamedTuple):
    """What a CHANGE sets: struct fjr_settings, gains, and K_md by rows [N m s/rad]."""

    settings: Any
    gains: Efforts
    hold_damping: Efforts


def changes(library: CLibrary, sequence: Sequence) -> Changes:
    """Return settings and gains of the changed scenario."""
    s = sequence.changed_scenario
    settings = settings_struct(library, s.settings, s.law)
    numbers = (np.ascontiguousarray(each, dtype=float) for each in (s.sampled_law.gain_values, s.law.hold_damping))
    return Changes(settings, *numbers)


class _Host:
    """Call the functions of step.h for all inputs, as a node does, and keep the efforts that they send."""

    def __init__(
        self, ffi: Any, lib: Any, model: Any, controller: Any, restart: Callable[[], None], changed: Changes
    ) -> None:
        self._ffi, self._lib, self._model, self._controller = ffi, lib, model, controller
        self._command = ffi.new("struct fjr_command *")
        self._sent: list[bytes] = []
        self._changed = changed
        self._other: dict[int, Callable[[], None]] = {
            Kind.HOLD: lambda: lib.fjr_hold(controller),
            Kind.RESUME: lambda: lib.fjr_resume(controller),
            Kind.CHANGE: self._change,
            Kind.RESTART: restart,
        }

    def replay(self, sequence: Sequence, repeats: bool = True) -> Replay:
        """Give all inputs to the step; repeats: see reference_replay."""
        counts, last = [], None
        for number in range(sequence.rounds):
            table = sequence.table_of(number)
            samples = table.ctypes.data + table.dtype.fields["stamp"][1]
            for k, (kind, time, stamp) in enumerate(table[["kind", "time", "stamp"]].tolist()):
                if kind == Kind.STATE and (repeats or stamp != last):
                    self._take_state(stamp if sequence.simulated else None, time, samples + k * table.itemsize)
                    last = stamp
                elif kind == Kind.TICK:
                    self._check_silence(time)
                elif kind in self._other:
                    self._other[kind]()
                counts.append(len(self._sent))
        counters = dict(zip(KINDS, self._controller.journal.count, strict=True))
        n = len(sequence.scenario.joints)
        return Replay(np.frombuffer(b"".join(self._sent)).reshape(-1, n), counts, counters)

    def _take_state(self, now: int | None, time: int, address: int) -> None:
        """Compute the command for a sample; now: simulated time, in which a silence ends with it."""
        if now is not None:
            self._check_silence(now)
        sample = self._ffi.cast("struct fjr_sample *", address)
        if self._lib.fjr_step(self._model, self._controller, sample, time, self._command):
            self._sent.append(bytes(self._ffi.buffer(self._command.u)))

    def _check_silence(self, now: int) -> None:
        u = self._command.u
        if self._lib.fjr_silence(self._model, self._controller, now, u):
            self._sent.append(bytes(self._ffi.buffer(u)))

    def _change(self) -> None:
        settings, *numbers = self._changed
        gains, damping = (self._ffi.cast("double *", each.ctypes.data) for each in numbers)
        self._lib.fjr_use_gains(self._controller, gains, damping)
        self._lib.fjr_apply(self._controller, settings)


def c_program(scenario: Scenario, folder: Path) -> Path:
    """Export a scenario as C, compile it with the host replay.c and return the program."""
    write(export(scenario, "fjr", SAMPLES), folder)
    sources = [*folder.glob("fjr*.c"), HERE / "replay.c"]
    return built([*C99, "-O2"], sources, folder / "replay", f"-I{folder}", f"-I{HERE}")


def controller_program(scenario: Scenario, folder: Path) -> Path:
    """Export a scenario for ros2_control, compile its controller with the host replay.cpp and return the program."""
    package = exported_package.package_name_of(scenario.name)
    exported_package.exported(scenario, folder, SAMPLES)
    return exported_package.linked(folder, package, CONTROLLER, HERE / "replay.cpp")


def program_efforts(program: Path, sequence: Sequence) -> Efforts:
    """Return all efforts (k, n) that a program sends."""
    inputs, changed = (program.with_name(name) for name in ("inputs", "changed"))
    inputs.write_bytes(sequence.table.tobytes())
    changed.write_bytes(_changed(sequence))
    numbers = map(str, (sequence.rounds, sequence.shift, int(sequence.simulated)))
    words = [str(program), str(inputs), *numbers, str(changed)]
    done = subprocess.run(words, stdout=subprocess.PIPE, timeout=HANG, check=True)
    return np.frombuffer(done.stdout).reshape(-1, len(sequence.scenario.joints))


def _changed(sequence: Sequence) -> bytes:
    """Return what a CHANGE sets, as replay.c reads it."""
    law = sequence.scenario.sampled_law
    library = step_library(law.robot.n, len(law.memory))
    settings, *numbers = changes(library, sequence)
    return b"".join([bytes(library.ffi.buffer(settings)), *(each.tobytes() for each in numbers)])


# Nodes.


EXECUTORS = {"rclpy": "events", "native": "native"}
"""Values of the parameter `executor` by host."""
LIMIT = 20.0  # s; timeout of an answer
RECORDS = 1000  # samples between two readings of the queue of a native loop
POLLS = 100  # of a native thread, between two events of its node
OPTIONS = {"realtime_priority": 0, "certificate": "false"}


class NodeHost:
    """A controller node, with a publisher of states and a listener to efforts in its namespace.

    A state is published once the last one was answered; or the callback of the command loop gets the message with its
    recorded time of arrival, so that no clock of this machine decides.
    """

    def __init__(self, context: Context, host: str, sequence: Sequence, file: Path) -> None:
        """Start the node with the parameters of the sequence, which are written to `file`."""
        self._context, self._host, self._sequence, self._file = context, host, sequence, file
        file.write_text(sequence.document, encoding="utf-8")
        self._peer = rclpy.create_node("peer", namespace=host, context=context, enable_rosout=False)
        self._states = self._peer.create_publisher(JointState, names.JOINT_STATES, names.LATEST)
        self._listener = self._peer.create_subscription(
            Float64MultiArray, names.EFFORT_COMMANDS, lambda _: None, QoSProfile(depth=1000)
        )
        self._heard: list[bytes] = []
        self._start()

    def efforts(self, counts: Iterable[int]) -> Efforts:
        """Feed the node with all inputs; return its efforts (k, n).

        counts: number of efforts after each input; an effort that does not come ends the replay.
        """
        for each, count in zip(self._sequence.repeated(), counts, strict=True):
            self._feed(each)
            if not self._until(lambda count=count: len(self._heard) >= count):
                break
        self._take()
        n = len(self._sequence.scenario.joints)
        return np.frombuffer(b"".join(raw[-8 * n :] for raw in self._heard)).reshape(-1, n)

    def close(self) -> None:
        """Destroy the nodes."""
        self._end()
        leave(self._peer)

    def _start(self) -> None:
        options = {**OPTIONS, "executor": EXECUTORS[self._host], "use_sim_time": str(self._sequence.simulated).lower()}
        words = [word for name, value in options.items() for word in ("-p", f"{name}:={value}")]
        arguments = ["--ros-args", "--params-file", str(self._file), *words, "-r", f"__ns:=/{self._host}"]
        self._node = ControllerNode(context=self._context, cli_args=arguments)
        self._loop: Any = self._node._control._command_loop
        self._native = self._host == "native"
        assert self._loop.native == self._native
        self._executor = EventsExecutor(context=self._context)
        if self._sequence.published:
            self._executor.add_node(self._node)
        else:
            self._loop._host.stop()  # the loop serves requests and messages of the caller
        states, answers = self._states, self._listener
        heard = [each for each in subscriptions(self._node) if each.topic_name == states.topic_name]  # by the loop
        sent = [each for each in self._node.publishers if each.topic_name == answers.topic_name]
        assert self._until(lambda: states.get_subscription_count() and all(one.get_publisher_count() for one in heard))
        assert self._until(lambda: answers.get_publisher_count() and all(one.get_subscription_count() for one in sent))

    def _end(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()

    def _feed(self, each: Input) -> None:
        tracker = self._node._control.step
        if each.kind is Kind.STATE:
            self._publish(each.raw) if self._sequence.published else self._deliver(each.raw, each.time)
        elif each.kind is Kind.TICK:
            self._loop.change("check_silence", time=each.time)
        elif each.kind is Kind.CHANGE:
            assert self._node.set_parameters_atomically(_parameters(each)).successful
        elif each.kind is Kind.PARAMETERS:
            self._refuses(each)
        elif each.kind is Kind.RESTART:
            self._end()
            self._start()
        else:
            {Kind.HOLD: tracker.hold, Kind.RESUME: tracker.resume}[each.kind]()

    def _publish(self, raw: bytes) -> None:
        before = self._received
        self._states.publish(raw)
        assert self._until(lambda: self._received > before)

    def _deliver(self, raw: bytes, arrival: int) -> None:
        program, struct = self._loop.program, self._loop._struct
        given = struct, 0, raw, len(raw), arrival, program.ffi.new("int64_t*")
        assert program.lib.fjr_controller_message(*given) == program.lib.FJR_GO_ON
        if self._received % RECORDS == 0:
            self._loop._drain()  # in simulated time a full queue would wait for this

    def _refuses(self, each: Input) -> None:
        for parameter in _parameters(each):
            with suppress(ParameterNotDeclaredException):
                assert not self._node.set_parameters([parameter])[0].successful

    @property
    def _received(self) -> int:
        """Number of states that the node has received."""
        return int(self._loop._struct.received)

    def _until(self, happened: Callable[[], Any]) -> bool:
        """Take efforts and let the node work until `happened()`; return False after the time limit."""
        limit, polls = None, 0
        self._take()
        while not happened():
            limit = limit or Limit(LIMIT)
            if limit.passed():
                return False
            polls += 1
            if self._sequence.published and (not self._native or polls % POLLS == 0):
                self._executor.spin_once(timeout_sec=0.0 if self._native else 0.01)
            self._take()
        return True

    def _take(self) -> None:
        while (taken := self._listener.handle.take_message(Float64MultiArray, True)) is not None:
            self._heard.append(taken[0])


def _parameters(each: Input) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in each.parameters.items()]
