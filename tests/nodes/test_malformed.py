# SPDX-License-Identifier: Apache-2.0
"""Malformed messages of each kind cause no exception and no output that is not finite or exceeds a limit.

Each is published alone, because a queue of depth one keeps the newest only. tests/msgs has the readers of states and
commands, and tests/tracking the control step for any state; here both are in their nodes, for `make test-all`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fjr_controller.controller_node import ControllerNode
from fjr_plant.plant_node import PlantNode
from fuzzing import fuzzed
from msgs.test_cdr import JOINT_STATES, JOINTS, NAMES
from nodes.harness import Ros, stamped
from nodes.managed import Manager
from nodes.plants import answer, command

HANDLED = ("commands received", "command refused", "answers to other states")  # beginnings of counters
LIMIT = (20.0, 10.0)  # N m
EACH, EXAMPLES = 10, 20  # messages of an example; FJR_FUZZ_EXAMPLES=1000 tries more

# Messages.

odd = st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 1e200, 5e-324, -0.0])
plain = st.floats(-3.0, 3.0)
number = st.one_of(plain, odd, st.floats(width=64))
name = st.one_of(
    st.sampled_from(NAMES), st.just(""), st.text(max_size=5), st.just("Ellbogen_\N{GREEK SMALL LETTER ZETA}")
)
stamp = st.one_of(
    st.builds(Time, sec=st.integers(95, 105), nanosec=st.integers(0, 10**9 - 1)),
    st.builds(Time, sec=st.sampled_from([0, -1, -(2**31), 2**31 - 1, 1]), nanosec=st.sampled_from([0, 1, 2**32 - 1])),
)


def column(size: int, entry: st.SearchStrategy[float] = number) -> st.SearchStrategy[list[float]]:
    """Generate a list, usually of this size."""
    right = st.lists(entry, min_size=size, max_size=size)
    return st.one_of(right, right, st.just([]), st.lists(entry, max_size=2 * size + 1))


@st.composite
def points(draw: st.DrawFn, size: int) -> JointTrajectoryPoint:
    entry = draw(st.sampled_from([number, plain, st.just(0.0)]))
    point = JointTrajectoryPoint(positions=draw(column(size, entry)))
    for field in ("velocities", "accelerations", "effort"):
        if draw(st.booleans()):
            setattr(point, field, draw(column(size, entry)))
    seconds = st.one_of(st.integers(0, 10), st.sampled_from([-1, -(2**31), 2**31 - 1]))
    point.time_from_start = Duration(sec=draw(seconds), nanosec=draw(st.sampled_from([0, 1, 10**6, 2**32 - 1])))
    return point


@st.composite
def good_trajectories(draw: st.DrawFn) -> JointTrajectory:
    """Generate points with positions only that start now."""
    rows = draw(st.lists(st.lists(plain, min_size=2, max_size=2), min_size=1, max_size=4))
    message = JointTrajectory(joint_names=list(draw(st.permutations(JOINTS))))
    for second, row in enumerate(rows, start=1):
        message.points.append(JointTrajectoryPoint(positions=row, time_from_start=Duration(sec=second)))
    return message


@st.composite
def any_trajectories(draw: st.DrawFn) -> JointTrajectory:
    names = draw(st.one_of(st.just(JOINTS), st.permutations(JOINTS), st.lists(name, max_size=4)))
    message = JointTrajectory(joint_names=list(names), points=draw(st.lists(points(len(names)), max_size=4)))
    message.header.stamp = draw(st.one_of(st.just(Time()), stamp))
    return message


trajectories = st.one_of(good_trajectories(), any_trajectories(), any_trajectories())
TWO_LINK = {
    "joints": list(JOINTS),
    "robot__model": "planar_two_link",
    "reference__amplitude": [0.5, 0.5],
    "limits__effort": list(LIMIT),
    "limits__effort_rate": [1000.0, 1000.0],
    "limits__link_position_lower": [-4.0, -4.0],
    "limits__link_position_upper": [4.0, 4.0],
    "limits__motor_velocity": [50.0, 50.0],
    "limits__deflection": [2.0, 2.0],
    "limits__tracking_error": [6.0, 6.0],
    "on_stop": "gravity_hold",
    "start__ramp_time": 0.2,
    "start__join_time": 0.5,
}


@pytest.fixture
def node(ros: Ros, manager: Manager) -> ControllerNode:
    return ros.controller(**TWO_LINK)


@fuzzed(EXAMPLES)
@given(messages=st.lists(trajectories, min_size=EACH, max_size=EACH))
def test_malformed_trajectories_are_refused_and_cause_no_invalid_effort(
    ros: Ros, manager: Manager, node: ControllerNode, messages: list[JointTrajectory]
) -> None:
    counted = node._control.reports.count

    def known() -> int:
        return sum(number for kind, number in counted.items() if kind.startswith("traject"))

    for message in messages:
        last = node._control.step.last_stamp or 200 * 10**9
        manager.answer(stamped(last * 1e-9 - 100 + 0.01, 0.1, 0.0, NAMES))
        before = known()
        manager.trajectories.publish(message)
        ros.until(lambda before=before: known() > before, "the trajectory's fate")
    assert_limited(manager)


def assert_limited(manager: Manager) -> None:
    for effort in (*(m.data for m in manager.efforts), *(m.effort for m in manager.commands)):
        assert len(effort) == 2
        assert all(abs(u) <= limit for u, limit in zip(effort, LIMIT, strict=True)), effort
    manager.efforts.clear()
    manager.commands.clear()


@pytest.mark.full
@fuzzed(EXAMPLES)
@given(messages=st.lists(JOINT_STATES, min_size=EACH, max_size=EACH))
def test_malformed_states_are_refused_and_cause_no_invalid_effort(
    ros: Ros, manager: Manager, node: ControllerNode, messages: list[JointState]
) -> None:
    loop = node._control._command_loop._struct
    for message in messages:
        before = loop.received
        manager.state_publisher.publish(message)
        ros.until(lambda before=before: loop.received > before, "its arrival")
    last = node._control.step.last_stamp or 200 * 10**9
    good = stamped((last + 10**9) % (2 * 10**18) * 1e-9 - 100, 0.1, 0.0, NAMES)

    def answered() -> bool:
        manager.state_publisher.publish(good)  # again, as another state confirms a jump of the stamps
        return bool(manager.commands) and manager.commands[-1].header == good.header

    ros.until(answered, "the answer to a good state")
    assert_limited(manager)


@pytest.fixture(params=[False, True], ids=["real time", "lock-step"])
def plant(request: pytest.FixtureRequest, manager: Manager) -> PlantNode:
    """Return a plant with an effort limit, without which a finite effort of 1e308 N m could make it diverge."""
    robot = {"joints": list(JOINTS), "robot__model": "planar_two_link", "imperfections__effort_limit": list(LIMIT)}
    return manager.plant(lockstep=request.param, lockstep_timeout=0.0, **robot)


@pytest.mark.full
@fuzzed(EXAMPLES)
@given(numbers=st.lists(column(2), min_size=EACH, max_size=EACH), named=st.lists(JOINT_STATES, min_size=EACH))
def test_malformed_commands_are_refused_and_leave_the_plant_finite(
    ros: Ros, manager: Manager, plant: PlantNode, numbers: list[list[float]], named: list[JointState]
) -> None:
    def handled() -> int:
        return sum(n for kind, n in plant._health.count.items() if kind.startswith(HANDLED))

    messages = named if plant.values["lockstep"] else [Float64MultiArray(data=row) for row in numbers]
    publisher = manager.command_publisher if plant.values["lockstep"] else manager.effort_publisher
    for message in messages:
        before = handled()
        publisher.publish(message)
        ros.until(lambda before=before: handled() > before, "its arrival")
    last = manager.states[-1].header

    def moves() -> bool:
        """Answer the newest state, as one of the messages may have answered the last one."""
        publisher.publish(answer(manager.states[-1], 0.0, JOINTS) if plant.values["lockstep"] else command(0.0, 0.0))
        return manager.states[-1].header != last

    ros.until(moves, "a state after a good command")
    ros.settle()
    assert all(np.isfinite([*each.position, *each.velocity, *each.effort]).all() for each in manager.states)
    del manager.states[:-1]
