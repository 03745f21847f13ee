# SPDX-License-Identifier: Apache-2.0
"""Time base of the robot: run, pause and advance its time; in real time here, in lock-step in lock_step.py."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, ClassVar

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fjr_core import FjrError
from fjr_core.config.plant import NONE, OBSTACLE_TYPE
from fjr_core.config.process import NATIVE
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import joint_state
from fjr_msgs_py.messages.joint_states import SECOND, deserialised, read_efforts
from fjr_msgs_py.native.loop import NO_TIME, NativeMessage
from fjr_msgs_py.node.parameters import ParameterNode
from fjr_msgs_py.node.reports import Health, Refusals

from .channel import Transport
from .host import Events, NativePlantHost, RclpyPlantHost
from .native import plant_program
from .simulated_robot import SimulatedRobot


def seconds(stamp: int) -> str:
    """Format a stamp [ns] in seconds with all digits."""
    sec, nanosec = divmod(stamp, SECOND)
    return f"{sec}.{nanosec:09d}"


Reply = Callable[[bool, str], None]
"""Sends success and message to a waiting client; called once, at any time and on any thread."""


class DeferredTrigger:
    """Trigger service whose callback receives a Reply, to be called now or later.

    It works with every executor of rclpy. The events executor of 7.1 does not accept coroutines as service callbacks;
    therefore the response that the executor sends when the callback returns is held back until the reply is given.
    """

    def __init__(self, node: Node, name: str, callback: Callable[[Reply], None]) -> None:
        self._callback = callback
        self._service = node.create_service(Trigger, name, self._on_request)
        self._send = self._service.send_response
        self._service.send_response = self._when_replied
        self._replied: Future[Trigger.Response] = Future()

    def _on_request(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        replied = self._replied = Future()

        def reply(success: bool, message: str) -> None:
            response.success, response.message = success, message
            replied.set_result(response)

        self._callback(reply)
        return response

    def _when_replied(self, _: Trigger.Response, header: Any) -> None:
        self._replied.add_done_callback(lambda replied: self._send(replied.result(), header))


WATCH_PERIOD = 0.05  # s between ticks in lock-step
REFUSALS_PERIOD = 0.05  # s; longest delay of the line about a refused command


class SendError(FjrError):
    """A message that could not be sent."""


class TimeBase(ABC):
    """Time base that runs, pauses or advances the robot; a sample has the stamp `offset` + robot time, see plant.h.

    An effort acts until the next one, at most for command_timeout of robot time; then the effort is zero. The host
    calls the C; what is rare runs here, between two messages of the host.
    """

    functions: ClassVar[str]
    """Name of the functions in C (plant.h), as in fjr_real_time_resume."""
    kind: ClassVar[type]
    topic: ClassVar[str]
    """Of the commands."""
    first: ClassVar[str]
    """What the first command is called."""

    def __init__(self, node: ParameterNode, robot: SimulatedRobot, transport: Transport, health: Health) -> None:
        self._node, self._robot, self._transport, self._health = node, robot, transport, health
        self._program: Any = plant_program()
        self._lib = self._program.lib
        self._samples = 0
        self._reply: Reply | None = None
        self._raised = False  # the error of the fault was raised
        self._lock_step = self.functions == "lock_step"
        states = node.create_publisher(JointState, names.JOINT_STATES, names.sample_qos(node, self._lock_step))
        self._publishers = [states, states]
        others: dict[int, Callable[[int], None]] = {
            self._lib.FJR_MOVING: lambda _: self._on_moving(),
            self._lib.FJR_ADVANCED: lambda _: self.end_advance(True, ""),
            self._lib.FJR_SECOND: self._health.at,
        }
        self._events = Events(self._program, self._health, others)
        self._refusals = Refusals(self._program, "command", lambda data: self._read(data), health.say)
        self.plant = self._built()
        if node.values[OBSTACLE_TYPE] != NONE:
            self._show_contact()
        self._health.add_counters(lambda: {**self._events.counts(self.plant), **self._refusals.report()})
        node.create_timer(REFUSALS_PERIOD, self._refusals.report, clock=names.STEADY)

    def _built(self) -> Any:
        """Return struct fjr_plant."""
        program, values, n = self._program, self._node.values, len(self._node.values["joints"])
        ffi = program.ffi
        self._arrays = [np.zeros(2 + 6 * n), np.zeros(2 + 6 * n), np.zeros(n), np.zeros(n)]
        self._pointers = [program.array(each) for each in self._arrays]
        named = names.state_names(values["joints"])
        lengths = ((2 * n, 0, 2 * n), (2 * n, 2 * n, 2 * n))
        self._messages = [NativeMessage(program, joint_state(named, each)) for each in lengths]
        plant = ffi.new("struct fjr_plant*")
        plant.robot, transport = self._robot.pointer, self._transport
        plant.states, plant.commands = transport.states.pointer, transport.commands.pointer
        plant.times = transport.times.pointer
        plant.state = [message.pointer for message in self._messages]
        plant.sample, plant.held, plant.effort, plant.coming = self._pointers
        plant.notify, plant.refusals = self._events.notify, self._refusals.pointer
        plant.command_timeout = round(values["command_timeout"] * 1e9)
        plant.paused = values["start_paused"]
        plant.by_stamps = bool(self._node.get_parameter("use_sim_time").value)
        plant.origin = plant.late_at = plant.between = plant.awaited = plant.other = plant.acts_at = NO_TIME
        return plant

    def _show_contact(self) -> None:
        """Publish what the obstacle does to the arm while they touch: torques on the joints, and the wrench."""
        named = (*self._node.values["joints"], *names.WRENCH)
        self._messages.append(NativeMessage(self._program, joint_state(named, (0, 0, len(named)))))
        self.plant.contact = self._messages[-1].pointer
        self._publishers[1] = self._node.create_publisher(JointState, names.CONTACT, names.HISTORY)

    def _serve(self, simulated: bool = False) -> None:
        """Let a host serve commands and ticks; simulated: the time comes from another publisher of /clock."""
        node, program = self._node, self._program
        callbacks = {"self": self.plant}
        for name, what in (("on_message", "command"), ("on_tick", "tick")):
            callbacks[name] = program.ffi.addressof(self._lib, f"fjr_{self.functions}_{what}")
        given = node, program, callbacks, self.kind, self.topic, self._fail
        why = self._without_loop(simulated)
        self.host: NativePlantHost | RclpyPlantHost
        if why:
            period = WATCH_PERIOD if self._lock_step else self._transport.period * 1e-9
            self.host = RclpyPlantHost(*given, simulated, period)
            if node.values["executor"] == NATIVE:
                node.get_logger().info(f"the plant runs in rclpy's executor instead of a native thread: {why}")
        else:
            self.host = NativePlantHost(*given)
        self.host.use(self._publishers)

    def _without_loop(self, simulated: bool) -> str:
        """Return why rclpy's executor serves the plant; "" if a native loop does."""
        if self._node.values["executor"] != NATIVE:
            return "another executor is selected"
        if simulated:
            return "the time comes from /clock"
        if not self._robot.in_machine_code:
            return "the plant is evaluated in Python (compile is false, engine is drake, or an own plant)"
        return self._program.without_thread

    @property
    def stamp(self) -> int:
        """Stamp [ns] of the present robot time."""
        return self.offset + self._robot.time

    @property
    def offset(self) -> int:
        """Stamp [ns] of robot time 0."""
        return int(self.plant.offset)

    @property
    def paused(self) -> bool:
        """True if robot time is paused."""
        return bool(self.plant.paused)

    def reset(self) -> None:
        """Return to the initial state and discard all messages in transit."""
        self.host.run(self._reset)

    def _reset(self) -> None:
        self.end_advance(False, "reset")
        self._robot.reset()
        self.plant.left, self.plant.last_command, self.plant.acts_at = 0, 0, NO_TIME
        self._transport.reset()
        self._call("restart")

    def pause(self, wanted: bool) -> None:
        """Pause or resume robot time."""
        self.host.run(lambda: self._pause(wanted))

    def _pause(self, wanted: bool) -> None:
        self.end_advance(False, "paused" if wanted else "resumed")
        self.plant.left = 0
        if wanted and not self.paused:
            self._call("catch_up")
        if wanted != self.paused:
            self.plant.paused = wanted
            if not wanted:
                self._call("resume")

    def advance(self, samples: int, reply: Reply) -> None:
        """Advance a paused robot by `samples`; reply when that is done or refused."""
        self.host.run(lambda: self._advance(samples, reply))

    def _advance(self, samples: int, reply: Reply) -> None:
        refusal = self._refusal()
        if refusal:
            reply(False, refusal)
            return
        self._samples = self.plant.left = samples
        self._reply = reply
        self._call("advance")

    def change(self, action: Callable[[], None]) -> None:
        """Integrate up to the present and then call an action that changes the robot; its FjrError is raised."""

        def caught_up() -> None:
            self._call("catch_up")
            action()

        self.host.run(caught_up)

    def close(self) -> None:
        """Stop serving commands."""
        self.host.close()

    def _refusal(self) -> str:
        if not self.paused:
            return "robot time is running; expected a paused robot: call ~/pause with true first"
        left = self.plant.left
        return f"already advancing: {left} of {self._samples} samples are left" if left else ""

    def end_advance(self, success: bool, why: str) -> None:
        """Reply to the client that waits for the end of an advance; on any thread."""
        reply, self._reply = self._reply, None
        if reply is None:
            return
        done = self._samples - self.plant.left
        how = f"advanced by {done} samples" if success else f"{why} after {done} of {self._samples} samples"
        reply(success, f"{how}: the time is {seconds(self.stamp)} s")

    def _call(self, what: str) -> None:
        """Call a function in C at the present time; raise the error of its fault."""
        fault = getattr(self._lib, f"fjr_{self.functions}_{what}")(self.plant, self.host.now())
        if fault:
            self._raised = True
            raise self._error_of(fault, "")

    def _error_of(self, fault: int, reason: str) -> FjrError:
        """Return the error of an enum fjr_fault; reason: of the native loop."""
        if self._events.error is not None:
            return self._events.error
        if fault == self._lib.FJR_NOT_SENT:
            return SendError(f"a message could not be sent: {reason or 'the publisher failed'}")
        return self._robot.error(fault)

    def _fail(self, reason: str) -> None:
        """End the node after a fault; called on any thread."""
        node = self._node
        if node.ended is None and not self._raised:
            node.end(self._error_of(self.plant.fault, reason))

    @abstractmethod
    def _read(self, data: bytes) -> None:
        """Read a serialised command as Python does; raises MessageError with the reason."""

    def _on_moving(self) -> None:
        sentence = f"moving: the first {self.first} has arrived"
        self._health.say("info", sentence, sentence)


class RealTime(TimeBase):
    """Time base that applies /effort_controller/commands and publishes a state at every tick of the clock.

    The clock is the steady one or, with use_sim_time, an external /clock (real_time.c). Robot time stands still until
    the first command (wait_for_command), while paused, and while the clock stands still or is 0. After a reset or a
    pause no state is published for restart_silence.
    """

    functions, kind, topic, first = "real_time", Float64MultiArray, names.EFFORT_COMMANDS, "command"

    def __init__(self, node: ParameterNode, robot: SimulatedRobot, transport: Transport, health: Health) -> None:
        super().__init__(node, robot, transport, health)
        plant = self.plant
        plant.simulated = bool(node.get_parameter("use_sim_time").value)
        plant.wait_for_command = node.values["wait_for_command"]
        plant.silence = round(node.values["restart_silence"] * 1e9)
        self._serve(bool(plant.simulated))
        self._call("catch_up")  # start the clock
        self.host.start()

    def _refusal(self) -> str:
        return super()._refusal() or (
            "" if self.plant.started else "no time has been received on /clock; expected one first"
        )

    def _read(self, data: bytes) -> None:
        read_efforts(deserialised(data, Float64MultiArray), self._node.values["joints"])
