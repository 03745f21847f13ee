# SPDX-License-Identifier: Apache-2.0
"""Limits of state and effort, the stop policies, and their parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from fjr_controller.tracking.effort_limits import EffortLimits
from fjr_controller.tracking.events import Journal
from fjr_controller.tracking.measured_state import MeasuredState
from fjr_controller.tracking.state_limits import StateLimits
from fjr_controller.tracking.stop_policy import StopPolicy
from fjr_core.config import builders
from fjr_core.config import parameter as parameters
from fjr_core.config.safety import safety, safety_parameters
from fjr_core.control.safety_settings import Settings
from tracking.tracked import paper_law, settings, two_link_law

INF = float("inf")
MS = 1_000_000

SIGNED = {"link_position": "link position", "motor_position": "motor position"}
SIZES = {
    "link_velocity": "link velocity",
    "motor_velocity": "motor velocity",
    "deflection": "deflection",
    "tracking_error": "tracking error",
}


def put(state: MeasuredState, name: str, joint: int, value: float) -> np.ndarray:
    """Set all quantities of a two-joint robot except one to zero; return the matching desired link positions."""
    state.values[:] = 0.0
    q_ld = np.zeros(2)
    if name in SIGNED:
        state.q_l[joint] = state.q_m[joint] = q_ld[joint] = value
    elif name == "deflection":
        state.q_m[joint] = value
    elif name == "tracking_error":
        q_ld[joint] = -value
    else:
        getattr(state, {"link_velocity": "dq_l", "motor_velocity": "dq_m"}[name])[joint] = value
    return q_ld


def state_limits(**given: object) -> tuple[MeasuredState, StateLimits]:
    state = MeasuredState(2)
    return state, StateLimits(settings(2, **given), state)


def effort_limits(n: int = 1, **given: object) -> EffortLimits:
    return EffortLimits(settings(n, **given), Journal())


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", [*SIGNED, *SIZES])
def test_a_limit_is_violated_just_beyond_its_value_and_names_the_joint(name: str, sign: float, joint: int) -> None:
    bound = [5.0, 5.0]
    bound[joint] = 0.7
    side = ("_upper" if sign > 0 else "_lower") if name in SIGNED else ""
    given = [sign * b for b in bound] if side else bound
    state, limits = state_limits(**{name + side: given})
    assert limits.violation(put(state, name, joint, sign * 0.7)) is None
    assert limits.violation(put(state, name, joint, -sign * 0.69)) is None
    value = float(np.nextafter(sign * 0.7, sign * INF))
    broken = limits.violation(put(state, name, joint, value))
    assert broken is not None
    assert (broken.kind, broken.joint) == ({**SIGNED, **SIZES}[name], f"joint{joint + 1}")
    assert (broken.value, broken.limit) == (value, sign * 0.7)
    assert f"{broken.kind} of joint{joint + 1}" in broken.sentence
    assert "0.7" in broken.sentence


@pytest.mark.parametrize("name", [*SIGNED, *SIZES])
def test_nothing_is_violated_without_limits(name: str) -> None:
    state, limits = state_limits()
    assert limits.violation(put(state, name, 0, 1e9)) is None


def test_efforts_within_the_limits_are_not_changed() -> None:
    efforts = effort_limits(2, effort=[1.0, 2.0], effort_rate=[1e3, INF])
    efforts.send(np.array([0.0, 0.0]), 0)
    u = np.array([1.0, -2.0])
    assert efforts.send(u, MS) is u
    assert not efforts.clipped
    assert not efforts.slowed


def test_the_time_in_saturation_is_that_between_the_stamps_joint_by_joint() -> None:
    efforts = effort_limits(2, effort=[1.0, 2.0])
    for k, u in enumerate([[3.0, 0.0], [-3.0, 5.0], [0.0, -5.0], [0.0, 0.0], [0.0, 0.0]]):
        sent = efforts.send(np.array(u), k * MS)
        np.testing.assert_array_equal(sent, np.clip(u, [-1, -2], [1, 2]))
        assert efforts.clipped == (k < 3)
    expected = {"in saturation": 3e-3, "in saturation: joint1": 2e-3, "in saturation: joint2": 2e-3}
    assert efforts.seconds == pytest.approx(expected, rel=1e-12)


def test_the_effort_rises_from_zero_at_its_rate_and_a_repeated_stamp_changes_nothing() -> None:
    efforts = effort_limits(2, effort_rate=[1000.0, INF])
    sent = [efforts.send(np.array([10.0, 10.0]), stamp * MS).copy() for stamp in (0, 1, 1, 3, 2, 3, 30)]
    np.testing.assert_allclose(sent, [[u, 10.0] for u in (0.0, 1.0, 1.0, 3.0, 3.0, 4.0, 10.0)], rtol=1e-12)


def test_after_a_jump_of_the_stamps_the_rate_counts_for_the_timeout_at_most() -> None:
    efforts = effort_limits(effort_rate=10.0, state_timeout=0.1)
    efforts.send(np.zeros(1), 0)
    np.testing.assert_allclose(efforts.send(np.array([1e3]), 10**18), 1.0)


def test_tighter_effort_limits_hold_at_once() -> None:
    efforts = effort_limits(effort_rate=1.0)
    efforts.replace(np.array([5.0]))
    efforts.apply(settings(effort=2.0, effort_rate=1.0))
    assert efforts.send(np.array([5.0]), MS) <= 2.0


@pytest.mark.parametrize("law", [paper_law(), two_link_law()], ids=["single", "two"])
def test_gravity_hold_compensates_gravity_and_damps_the_motors(law: fjr.TrackingLaw) -> None:
    n = law.robot.n
    policy = StopPolicy(law, settings(n, on_stop="gravity_hold"))
    q, dq = np.linspace(0.4, 0.9, n), np.linspace(0.3, -0.5, n)
    assert not policy.standing().any()
    policy.remember(q)
    np.testing.assert_allclose(policy.standing(), np.linalg.solve(law.robot.B_m, law.robot.grad_P_l(q)), rtol=1e-12)
    damping = law.robot.B_m @ (policy.standing() - policy.moving(q, dq))
    np.testing.assert_allclose(damping, law.gains.K_md @ dq, rtol=1e-9)
    assert dq @ damping > 0


def test_gravity_hold_is_finite_for_any_motor_velocity() -> None:
    policy = StopPolicy(paper_law(), settings(on_stop="gravity_hold"))
    policy.remember(np.array([0.5]))
    np.testing.assert_array_equal(policy.moving(np.array([0.5]), np.array([1e300])), policy.standing())


def test_zero_policy_sends_zero_effort() -> None:
    policy = StopPolicy(paper_law(), settings())
    policy.remember(np.ones(1))
    assert not policy.standing().any()
    assert not policy.moving(np.ones(1), np.ones(1)).any()


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


def test_every_parameter_reaches_the_settings() -> None:
    for parameter in safety_parameters(1):
        if isinstance(parameter.default, tuple):
            value = -1.5 if parameter.name.endswith("lower") else 1.5
            made = built(**{parameter.name: (value,)})
            assert getattr(made, parameter.name.removeprefix("limits.")) == [value]
    made = built(
        on_stop="gravity_hold",
        state_timeout=0.2,
        start__ramp_time=0.3,
        start__join_time=0.4,
        recovery__join_time=0.5,
        hold__deceleration=0.6,
    )
    times = (made.state_timeout, made.ramp_time, made.start_join_time, made.recovery_join_time, made.hold_deceleration)
    assert (made.on_stop, *times) == ("gravity_hold", 0.2, 0.3, 0.4, 0.5, 0.6)


def test_all_are_parameters_of_the_controller() -> None:
    theirs = {p.name for p in builders.controller_parameters(2)}
    assert {p.name for p in safety_parameters(2)} <= theirs


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


def test_limits_from_a_robot_without_limits_are_refused() -> None:
    with pytest.raises(fjr.ParameterError, match=r"limits.from_robot' is true; expected false"):
        built(**{"limits.from_robot": True})


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"limits.effort": (1.0, 2.0)}, "'limits.effort' has 2 entries; expected 1"),
        ({"limits.effort": (-1.0,)}, "expected at least 0.0 N m"),
        ({"limits.deflection": (float("nan"),)}, "expected a finite number"),
        ({"limits.link_position_lower": (1.0,), "limits.link_position_upper": (0.0,)}, "of joint1 is 0 rad; expected"),
        ({"on_stop": "brake"}, "expected one of zero, gravity_hold"),
        ({"state_timeout": 0.0}, "expected 0.001 to"),
        ({"recovery.join_time": 1e-5}, "expected 0 for none, or at least 0.001 s"),
    ],
)
def test_invalid_values_are_refused_with_a_sentence(given: dict[str, object], sentence: str) -> None:
    with pytest.raises(fjr.ParameterError, match=sentence):
        built(**given)


def test_settings_refuse_nan() -> None:
    with pytest.raises(fjr.ParameterError, match="limits.deflection"):
        settings(deflection=float("nan"))
