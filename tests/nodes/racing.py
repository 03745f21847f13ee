# SPDX-License-Identifier: Apache-2.0
"""Run native loops while Python does all that it can do beside them: `python -m nodes.racing`, for test_races.py."""

from __future__ import annotations

from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from fjr_msgs_py.names import LATEST
from nodes.harness import Listener, Ros
from nodes.managed import CONTROLLER, Manager, trajectory

FAR = {"limits__tracking_error": [1e3], "limits__effort": [30.0]}  # no stop on a machine with little time
JUMP = 0.5  # s; in lock-step the stamps after a reset are believed after this silence
STATES = 20  # answered between two actions
DAMAGED = (
    JointState(name=["unknown"]),
    JointState(name=["joint1", "joint1_motor"], position=[0.0]),
    JointState(name=["joint1", "joint1"]),
)


class Quiet(Manager):
    """A manager that hears no topic, as Python would not keep up with those of a run in lock-step."""

    def __init__(self, ros: Ros) -> None:
        Listener.__init__(self, ros, only=())
        self.trajectories = self.create_publisher(JointTrajectory, f"{CONTROLLER}/joint_trajectory", 10)
        self.senders = [self.create_publisher(JointState, name, LATEST) for name in ("joint_states", "joint_commands")]
        self.effort_publisher = self.create_publisher(Float64MultiArray, "effort_controller/commands", LATEST)

    def send_damaged(self, message: JointState) -> None:
        """Send the message to the controller and to a plant in either mode."""
        for sender in self.senders:
            sender.publish(message)
        self.effort_publisher.publish(Float64MultiArray(data=[1.0, 2.0]))


def run(lockstep: bool) -> None:
    """Refuse messages, change gains, limits, reference and robot, pause, advance, reset, and start the loop again."""
    with Ros() as ros:
        manager = Quiet(ros)
        node = ros.controller(**FAR, use_sim_time=lockstep, state_timeout=JUMP)
        plant = ros.plant(lockstep=lockstep, advance_samples=100_000 if lockstep else 100)
        loop, reports = node._control._command_loop._struct, node._control.reports

        def go_on() -> None:
            last = loop.answered + STATES
            ros.until(lambda: loop.answered >= last, "further states")

        def refused(count: Any) -> int:
            return sum(number for kind, number in count.items() if "refused" in kind)

        go_on()
        manager.pause(True)  # else the next good message may replace a damaged one
        for message in DAMAGED:
            before = refused(reports.count), refused(plant._health.count)
            manager.send_damaged(message)
            ros.until(lambda b=before: refused(reports.count) > b[0] and refused(plant._health.count) > b[1], "both")
        manager.pause(False)
        assert manager.set(gains__K_ld=[0.7], limits__tracking_error=[100.0])[0]
        manager.trajectories.publish(trajectory((0.5, 0.3), (1.0, -0.2)))
        ros.until(lambda: reports.count["trajectories accepted"], "the trajectory")
        for name in ("hold", "play", "resume"):
            manager.trigger(name)
            go_on()
        for _ in range(3):
            manager.pause(True)
            advance = manager.request(Trigger, "fjr_plant/advance")
            if lockstep:
                go_on()
            manager.reset()
            ros.until(advance.done, "the response")
            manager.pause(False)
            go_on()
        assert manager.change("deactivate")
        assert manager.change("activate")
        go_on()


def fail() -> None:
    """Read the controller that Python has while the loop ends by a failure."""
    with Ros() as ros:
        node = ros.controller(**FAR)
        ros.plant()
        command_loop, step = node._control._command_loop, node._control.step
        ros.until(lambda: command_loop._struct.answered > STATES, "the first states")
        host, jets = command_loop._host, step.ffi.new("double[]", step.jets.size)
        step.lib.fjr_jets_at(step.controller, 0, jets)
        host._addresses[0] = command_loop.program.ffi.cast("void*", host.subscriptions[0].address)  # no publisher
        while host.runs:
            step.lib.fjr_jets_at(step.controller, 0, jets)
        ros.until(lambda: node.ended is not None, "the end")


if __name__ == "__main__":
    run(lockstep=True)
    run(lockstep=False)
    fail()
    print("done")
