# SPDX-License-Identifier: Apache-2.0
"""Limits of state and effort, the stop policies, and their parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import parameter as parameters
from fjr_core.config.controller import safety, safety_parameters
from fjr_core.motions.point_to_point import Hold
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import Event, State
from fjr_core.runtime.safety_settings import Settings
from fuzzing import refused
from tracking.tracked import LAW, LIMITED, MS, TWO, Passed, sample, settings

INF = float("inf")


def stop_at(tracker: ControlStep, name: str, joint: int, value: float) -> Event | None:
    """Start where only the limited quantity of a joint, of size `value`, is not zero; return the event of a stop."""
    parts = np.zeros((4, 2))
    parts[:, joint] = LIMITED[name][1](value)
    tracker.start()
    assert tracker.command(sample(0, *parts), 0) is not None
    found = [event for event in tracker.events if event.kind == "stops"]
    tracker.events.clear()
    assert bool(found) == (tracker.state is State.STOPPED)
    return found[0] if found else None


def passing(n: int = 1, **given: object) -> ControlStep:
    """Return a tracker whose law has the link positions as its effort."""
    robot = (LAW if n == 1 else TWO).robot
    return ControlStep(fjr.PythonLaw(Passed(robot), robot), Hold(np.zeros(n)), settings(n, **given), simulated=True)


def send(tracker: ControlStep, u: Any, stamp: int) -> np.ndarray:
    """Return the effort sent where the law's is u."""
    command = tracker.command(sample(stamp, u, u), stamp)
    return command.u


SIZES = ("link_velocity", "motor_velocity", "deflection", "tracking_error")


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize(("name", "sign"), [*((name, 1.0) for name in LIMITED), *((name, -1.0) for name in SIZES)])
def test_a_limit_is_violated_just_beyond_its_value_and_names_the_joint(name: str, sign: float, joint: int) -> None:
    bound = np.full(2, 5.0)
    bound[joint] = 0.7
    tracker = ControlStep(TWO, Hold([0.0, 0.0]), settings(2, **{name: -bound if name.endswith("lower") else bound}))
    assert stop_at(tracker, name, joint, sign * 0.7) is None
    assert stop_at(tracker, name, joint, -sign * 0.69) is None
    size = float(np.nextafter(0.7, INF))
    broken, kind = stop_at(tracker, name, joint, sign * size), LIMITED[name][0]
    assert broken.level == "error"
    assert tracker.counters == {"stops": 1, f"stops: {kind}": 1}
    values = broken.values
    beyond = -size if name.endswith("lower") or (name in SIZES and values["value"] < 0) else size
    assert values == {**values, "joint": f"joint{joint + 1}", "value": beyond, "limit": np.copysign(0.7, beyond)}
    assert f"{kind} of joint{joint + 1}" in broken.sentence
    assert "0.7" in broken.sentence


@pytest.mark.parametrize("on_stop", ["zero", "gravity_hold"])
@pytest.mark.parametrize("value", [1e100, 1e308])
@pytest.mark.parametrize("name", LIMITED)
def test_a_finite_value_of_any_size_beyond_a_limit_latches_a_stop(name: str, value: float, on_stop: str) -> None:
    """Also one whose square overflows, as of a wrong unit or a bad cast in a driver: it is no value to wait out."""
    sign = -1.0 if name.endswith("lower") else 1.0
    tracker = ControlStep(LAW, Hold([0.0]), settings(on_stop=on_stop, **{name: sign}))
    tracker.command(sample(0, 0.0, 0.0), 0)
    commands = [tracker.command(sample(MS, *LIMITED[name][1](value)), MS)]
    commands.append(tracker.command(sample(2 * MS, 0.0, 0.0), 2 * MS))
    assert tracker.state is State.STOPPED
    assert "efforts not finite" not in tracker.counters
    assert all(np.isfinite(command.u).all() for command in commands)


def test_the_time_in_saturation_is_that_between_the_stamps_joint_by_joint() -> None:
    tracker = passing(2, effort=[1.0, 2.0])
    for k, u in enumerate([[3.0, 0.0], [-3.0, 5.0], [0.0, -5.0], [0.0, 0.0], [0.0, 0.0]]):
        np.testing.assert_array_equal(send(tracker, u, k * MS), np.clip(u, [-1, -2], [1, 2]))
        assert tracker.counters["efforts saturated"] == min(k + 1, 3)
    expected = {"in saturation": 3e-3, "in saturation: joint1": 2e-3, "in saturation: joint2": 2e-3, "stopped": 0.0}
    assert tracker.seconds == pytest.approx(expected, rel=1e-12)


def test_the_effort_rises_from_zero_at_its_rate_and_a_repeated_or_older_stamp_changes_nothing() -> None:
    tracker = passing(2, effort_rate=[1000.0, INF])
    sent = [send(tracker, [10.0, 10.0], stamp * MS) for stamp in (0, 1, 1, 3)]
    assert tracker.command(sample(2 * MS, [10.0, 10.0], 0.0), 3 * MS) is None
    sent += [send(tracker, [10.0, 10.0], stamp * MS) for stamp in (3, 4, 30, 31)]
    np.testing.assert_allclose(sent, [[u, 10.0] for u in (0.0, 1.0, 1.0, 3.0, 3.0, 4.0, 10.0, 10.0)], rtol=1e-12)
    assert tracker.counters["efforts rate limited"] == 6


def test_after_a_jump_of_the_stamps_the_rate_counts_for_the_timeout_at_most_and_a_constant_effort_has_none() -> None:
    tracker = passing(effort_rate=10.0, state_timeout=0.1, recovery_join_time=0.0)
    for stamp in (0, 0, MS):
        send(tracker, [0.0], stamp)
    assert "efforts rate limited" not in tracker.counters
    np.testing.assert_allclose(send(tracker, [1e3], 10**18), 1.0)


def test_the_effort_of_a_latched_stop_keeps_its_rate_and_that_of_a_shutdown_does_not() -> None:
    tracker = passing(effort_rate=1000.0, motor_velocity=5.0)
    for stamp in range(11):
        send(tracker, [10.0], stamp * MS)
    sent = [tracker.command(sample(k * MS, 10.0, 10.0, 0.0, 9.0), k * MS).u[0] for k in (11, 12, 14)]
    assert tracker.state is State.STOPPED
    assert sent == pytest.approx([9.0, 8.0, 6.0])
    assert tracker.stop_effort() == pytest.approx([0.0])


def test_tighter_effort_limits_hold_at_once() -> None:
    tracker = passing()
    assert send(tracker, [5.0], 0) == 5.0
    tracker.apply(settings(effort=2.0, effort_rate=1.0))
    assert send(tracker, [5.0], MS) <= 2.0


def stopped(law: fjr.TrackingLaw, state: Any, **given: object) -> tuple[ControlStep, np.ndarray]:
    """Return a tracker that stopped at a state, and the effort that it sent for it."""
    tracker = ControlStep(law, Hold(np.zeros(law.robot.n)), settings(law.robot.n, link_position_upper=0.1, **given))
    assert not tracker.stop_effort().any()
    command = tracker.command(state, 0)
    assert tracker.state is State.STOPPED
    return tracker, command.u


def test_gravity_hold_compensates_gravity_and_damps_the_motors() -> None:
    q, dq = np.array([0.4, 0.9]), np.array([0.3, -0.5])
    tracker, _ = stopped(TWO, sample(0, q, q, 0.0, dq), on_stop="gravity_hold")
    for k in (1, 2):
        moving = tracker.command(sample(k * MS, q, q + dq * k * 1e-3, 0.0, dq), k * MS).u
    standing = tracker.stop_effort()
    np.testing.assert_allclose(standing, np.linalg.solve(TWO.robot.B_m, TWO.robot.grad_P_l(q)), rtol=1e-12)
    damping = TWO.robot.B_m @ (standing - moving)
    np.testing.assert_allclose(damping, TWO.gains.K_md @ dq, rtol=1e-9)
    assert dq @ damping > 0


@pytest.mark.parametrize("speed", [1e154, 1e300], ids=["effort", "state"])
def test_gravity_hold_is_finite_for_any_motor_velocity(speed: float) -> None:
    """The square of the effort, or already that of the velocity, overflows: the effort at standstill is sent."""
    law = LAW.with_gains(replace(fjr.PAPER_GAINS, K_md=100.0))
    tracker, _ = stopped(law, sample(0, 0.5, 0.5), on_stop="gravity_hold")
    command = tracker.command(sample(MS, 0.5, 0.5, 0.0, speed), MS)
    np.testing.assert_array_equal(command.u, tracker.stop_effort())
    np.testing.assert_allclose(command.u, LAW.robot.grad_P_l([0.5]), rtol=1e-12)


def built(n: int = 1, robot: fjr.Robot | None = None, **given: object) -> Settings:
    words = {name.replace("__", "."): value for name, value in given.items()}
    joints = tuple(f"joint{i + 1}" for i in range(n))
    values = parameters.complete(safety_parameters(n), words)
    return safety({**values, "joints": joints}, robot or fjr.single_link())


def test_nothing_is_limited_by_default() -> None:
    made, off = built(), settings()
    for name in (p.name.removeprefix("limits.") for p in safety_parameters(1) if isinstance(p.default, tuple)):
        assert np.isinf(getattr(made, name)).all()
        np.testing.assert_array_equal(getattr(made, name), getattr(off, name))
    assert (made.on_stop, made.ramp_time, made.start_join_time) == ("zero", 0.0, 0.0)
    assert made.joints == ("joint1",)


def limited_robot() -> fjr.Robot:
    limits = fjr.JointLimits(np.array([-1.0]), np.array([INF]), np.array([3.0]), np.array([20.0]))
    return replace(fjr.single_link(), limits=limits)


def test_the_tighter_of_own_and_robot_limits_applies() -> None:
    own = {"limits.effort": (30.0,), "limits.link_velocity": (2.0,), "limits.link_position_lower": (-2.0,)}
    made = built(robot=limited_robot(), **own, **{"limits.from_robot": True})
    assert (made.effort, made.link_velocity) == (20.0, 2.0)
    assert (made.link_position_lower, made.link_position_upper) == (-1.0, INF)
    assert np.isinf([made.motor_velocity, made.motor_position_lower, made.effort_rate]).all()
    assert built(robot=limited_robot(), **own).effort == 30.0


REFUSED: dict[str, dict[str, Any]] = {
    "limits.from_robot' is true; expected false": {"limits.from_robot": True},
    "'limits.effort' has length 2; expected 1": {"limits.effort": (1.0, 2.0)},
    "expected at least 0.0 N m": {"limits.effort": (-1.0,)},
    "expected a finite number": {"limits.deflection": (float("nan"),)},
    "of joint1 is 0 rad; expected": {"limits.link_position_lower": (1.0,), "limits.link_position_upper": (0.0,)},
    "expected one of zero, gravity_hold": {"on_stop": "brake"},
    "expected 0.001 to": {"state_timeout": 0.0},
    "expected 0 for none, or at least 0.001 s": {"recovery.join_time": 1e-5},
}


def test_invalid_values_are_refused_with_a_sentence() -> None:
    for sentence, given in REFUSED.items():
        refused(fjr.ParameterError, lambda given=given: built(**given), sentence)
    refused(fjr.ParameterError, lambda: settings(deflection=float("nan")), "limits.deflection")


def test_a_change_of_position_that_may_be_noise_is_no_jump() -> None:
    tracker = passing(link_velocity=1e-3)
    for k, q_l in enumerate((0.0, 0.009, 0.0, 0.011)):
        tracker.command(sample(k * MS, q_l, 0.0), k * MS)
        assert tracker.counters["stops: position jump"] == (q_l > 0.01)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_link_that_moves_as_far_as_its_velocity_says_stops_for_the_velocity_and_not_for_a_jump(sign: float) -> None:
    tracker = passing(link_velocity=1.0)
    for k, (q, dq) in enumerate(((0.0, 0.0), (0.1, 10.0))):
        tracker.command(sample(k * MS, sign * q, 0.0, sign * dq), k * MS)
    assert tracker.counters == {"stops": 1, "stops: link velocity": 1}


def test_a_deflection_is_that_of_the_spring_wherever_the_arm_is() -> None:
    q = np.array([2.0, -2.0])
    tracker = ControlStep(TWO, Hold(q), settings(2, deflection=0.1))
    assert tracker.command(sample(0, q, 1.04 * q), 0).state is State.TRACKING
