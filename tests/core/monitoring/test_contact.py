# SPDX-License-Identifier: Apache-2.0
"""The contact alarm: Z is the effect of stated errors, the distance has its distribution, learning is Bayes' rule."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

import fjr_core as fjr
from core.oracles.cases import Array
from core.oracles.chains import arm7
from fjr_core.monitoring.external_torque import (
    DAY,
    STICKING,
    WRONG,
    ContactObserver,
    ExternalTorqueObserver,
    StatedErrors,
    TorqueObserverStruct,
)
from fjr_core.runtime.library import step_library

L = 40.0  # 1/s
MASS, INERTIA, K, D = np.array([1.2, 0.8]), np.array([0.02, 0.01]), np.array([90.0, 60.0]), np.array([0.3, 0.2])
NOISE = np.array([0.02, 0.01])
STATED = {"link_mass": [0.1, 0.2], "joint_stiffness": 0.1, "link_damping": 0.5, "link_coulomb_friction": [0.1, 0.05]}
ERRORS = StatedErrors(2, **STATED, link_torque=[0.05, 0.02], torque_noise=NOISE)
T = np.arange(120) * 1e-3
QUIET = 200_000_000  # ns, until a contact has ended


def robot(d: Array) -> fjr.Robot:
    """Return the arm whose masses, stiffness and damping differ by d (10,), in standard deviations."""
    mass, stiffness, damping = (1 + (ERRORS.deviations * d).reshape(5, 2))[:3]
    given = {"link_mass": MASS * mass, "link_inertia": INERTIA * mass, "link_damping": D * damping}
    return fjr.planar_two_link(**given, stiffness=K * stiffness)


def motion(d: Array, tau: Array | float = 0.0, t: Array = T) -> tuple[Array, Array]:
    """Return positions and velocities (k, 4) of links on sines at times t, of the arm that differs by d."""
    arm, (friction, constant) = robot(d), (ERRORS.deviations * d).reshape(5, 2)[3:]
    angle, w = np.array([3.0, 5.0]) * t[:, None] + [0.3, 1.0], np.array([3.0, 5.0])
    q, dq, ddq = 0.8 * np.sin(angle), 0.8 * w * np.cos(angle), -0.8 * w**2 * np.sin(angle)
    rigid = [arm.M_l(x) @ a + arm.coriolis(x, v, v) + arm.grad_P_l(x) for x, v, a in zip(q, dq, ddq, strict=True)]
    torque = np.array(rigid) + dq @ arm.D_l + friction * np.tanh(dq / STICKING) - constant - tau
    return np.hstack([q, q + torque / np.diag(arm.K)]), np.hstack([dq, dq])


KNOWN = ContactObserver(robot(np.zeros(10)), L, ERRORS)


class Watch:
    """The alarm in C, without learning unless a period [ns] is given."""

    def __init__(self, period: int = 2**62, **given: Any) -> None:
        self.lib = step_library(2)
        self.held = TorqueObserverStruct(self.lib.ffi, KNOWN)
        self.o, self.contact = self.held.pointer, self.lib.ffi.new("struct fjr_contact*")
        self.o.period = period
        for name, value in {"step": [0.0] * 4, **given}.items():  # exact encoders
            setattr(self.o, name, value)

    def see(self, position: Array, velocity: Array, first: int = 0, t: Array = T) -> None:
        for k, row in enumerate(zip(position, velocity, strict=True), start=first):
            stamp = round(1e9 * t[k]) if k < len(t) else k * 1_000_000
            values = [self.lib.ffi.from_buffer("double[]", np.ascontiguousarray(each)) for each in row]
            assert self.lib.lib.fjr_watch_torque(self.o, self.contact, *values, stamp)

    def array(self, name: str, size: int) -> Array:
        return np.array(list(self.held.arrays[name][0:size]))

    @property
    def r(self) -> Array:
        return self.array("kept", 66)[44:46]

    @property
    def Z(self) -> Array:
        return self.array("kept", 66)[46:].reshape(10, 2).T

    @property
    def e(self) -> Array:
        return np.array(list(self.o.compared[0:2]))

    @property
    def S(self) -> Array:
        lower = np.tril(np.reshape(list(self.o.S[0:4]), (2, 2)))
        return lower + np.tril(lower, -1).T


@pytest.mark.parametrize("kind", [0, 1, 3, 5, 6, 9])
def test_residual_is_minus_Z_times_the_error_of_the_robot(kind: int) -> None:
    """The oracle is the arm built with other numbers; velocities of samples make the error of order 2 in dt."""
    d = np.zeros(10)
    d[kind] = 1.0
    watch, exact = Watch(), Watch()
    watch.see(*motion(d))
    exact.see(*motion(0 * d))
    estimated = ExternalTorqueObserver(robot(0 * d), L).along(T, *motion(d))[-1, -2:]
    np.testing.assert_allclose(watch.r, estimated, rtol=0, atol=1e-13)
    np.testing.assert_allclose(watch.r - exact.r, -watch.Z @ d, rtol=2e-3, atol=1e-6)


def test_whole_motion_gives_what_the_samples_give_one_by_one() -> None:
    watch, plain = Watch(), ExternalTorqueObserver(robot(np.zeros(10)), L)
    watch.see(*motion(np.ones(10)))
    kept = KNOWN.along(T, *motion(np.ones(10)))
    np.testing.assert_allclose(kept[-1], watch.array("kept", 66), rtol=0, atol=1e-13)
    np.testing.assert_allclose(kept[:, 44:46], plain.along(T, *motion(np.ones(10)))[:, 4:], rtol=0, atol=1e-13)


SHARED_EQUATIONS = [
    {"link_mass": [4.0, 1.0], "link_com": [0.5, 0.5], "link_inertia": [4.0, 1.0]},
    {"link_mass": [4.0, 2.0], "link_com": [0.25, 0.25], "link_inertia": [3.75, 1.125]},
]
"""Bodies of two arms that move alike: their inertia, gravity and springs are equal."""


def test_arms_that_move_alike_and_have_other_bodies_have_their_own_compiled_code() -> None:
    arms = [fjr.planar_two_link(**bodies, link_length=1.0, gravity=8.0) for bodies in SHARED_EQUATIONS]
    assert arms[0].fingerprint() == arms[1].fingerprint()
    q, dq = motion(np.zeros(10))
    found = {
        compiles: [ContactObserver(arm, L, StatedErrors(2), compiles).along(T, q, dq)[-1] for arm in arms]
        for compiles in (False, True)
    }
    assert np.abs(found[False][0] - found[False][1]).max() > 1e-2
    np.testing.assert_allclose(found[True], found[False], rtol=0, atol=1e-9)


def test_distance_of_drawn_robots_has_the_distribution_of_chi_squared() -> None:
    """20,000 robots and noises: r of each by the Z that the test above has shown; the alarm is that of the limit."""
    rng, watch = np.random.default_rng(5), Watch()
    watch.see(*motion(np.zeros(10)))
    r0, Z = watch.r, watch.Z
    r = r0 - rng.normal(size=(20_000, 10)) @ Z.T + NOISE * rng.normal(size=(20_000, 2))
    integration = np.array(list(watch.o.integration[0:2]))
    np.testing.assert_allclose(watch.S, Z @ Z.T + np.diag(NOISE**2 + integration**2), rtol=1e-12)
    np.testing.assert_allclose(watch.S, np.cov(r.T), rtol=0.04)
    squared = np.einsum("ki,ij,kj->k", r, np.linalg.inv(watch.S), r)
    for share in (0.1, 1e-2, 1e-3):
        expected = 20_000 * share
        assert abs((squared > stats.chi2.ppf(1 - share, 2)).sum() - expected) < 5 * np.sqrt(expected)


def test_threshold_is_that_of_one_wrong_sample_in_a_day_at_95_percent() -> None:
    assert stats.poisson.cdf(1, WRONG) == pytest.approx(0.95, abs=2e-3)
    observer = ContactObserver(arm7().robot, L, StatedErrors(7))
    assert stats.chi2.sf(observer.limit, 7) * DAY == pytest.approx(WRONG, rel=1e-6)


@pytest.mark.parametrize("push", [0.0, 0.3, 3.0])
def test_alarm_is_where_the_distance_exceeds_its_limit(push: float) -> None:
    watch = Watch()
    watch.see(*motion(np.ones(10), np.where(T[:, None] > 0.08, [0.0, push], 0.0)))
    squared = watch.e @ np.linalg.solve(watch.S, watch.e)
    np.testing.assert_allclose(
        np.array(list(watch.o.compared[2:4])), np.sqrt(watch.o.limit * np.diag(watch.S)), rtol=1e-12
    )
    assert watch.contact.acting == (squared > watch.o.limit) == (push == 3.0)
    if push == 3.0:
        assert (watch.contact.joint, watch.contact.joints) == (1, 2)
        assert watch.contact.value > watch.contact.limit


def test_alarm_begins_at_the_push_whose_distance_is_its_limit() -> None:
    """By bisection; both joints are pushed, so that the distance needs the covariance of their torques."""
    position, velocity = motion(np.ones(10))

    def ratio(push: float) -> tuple[bool, float]:
        watch, torque = Watch(), np.where(T[:, None] > 0.08, [push, -push / 2], 0.0)
        watch.see(position - np.hstack([0 * torque, torque / K]), velocity)
        return bool(watch.contact.acting), float(watch.e @ np.linalg.solve(watch.S, watch.e) / watch.o.limit)

    low, high = 0.0, 8.0
    for _ in range(10):
        middle = (low + high) / 2
        low, high = (low, middle) if ratio(middle)[0] else (middle, high)
    assert ratio(low) == (False, pytest.approx(1.0, abs=0.02))
    assert ratio(high) == (True, pytest.approx(1.0, abs=0.02))


@pytest.mark.parametrize(("share", "joints"), [(0.1, 0b11), (0.02, 0b01)])
def test_small_torques_name_their_joints_by_their_share_of_the_largest(share: float, joints: int) -> None:
    noise, push = 1e-4, 0.3  # N m
    watch = Watch(noise=[noise**2] * 2)
    for k in range(100):
        watch.o.P[k] = 0.0  # the model is known
    watch.see(*motion(np.zeros(10), np.where(T[:, None] > 0.02, [push, share * push], 0.0)))
    assert np.abs(watch.e) == pytest.approx([push, share * push], rel=0.05)
    assert watch.contact.joints == joints


def test_a_late_state_is_no_contact() -> None:
    """With the noise alone it would be one: the trapezoidal rule has an error of dt^2 / 12 f''."""
    noise, t = 1e-4, np.append(T, T[-1] + 0.08)
    watch = Watch(noise=[noise**2] * 2)
    for k in range(100):
        watch.o.P[k] = 0.0  # the model is known
    watch.see(*motion(np.zeros(10), t=t), t=t)
    assert np.sum((watch.e / noise) ** 2) > 3 * watch.o.limit
    assert not watch.contact.acting


STEPS = 2 * np.pi / 2.0 ** np.array([14, 13, 15, 12])  # rad, of each encoder


@pytest.mark.parametrize("number", [np.float64, np.float32])
def test_rounding_of_the_encoders_is_noise_of_the_springs_by_the_steps_that_the_positions_show(number: type) -> None:
    watch, (q, dq) = Watch(step=[np.inf] * 4), motion(np.zeros(10))
    for k in range(100):
        watch.o.P[k] = 0.0  # the model is known
    encoders = (np.round(each / STEPS) * STEPS for each in (np.tile(q[0], (50, 1)), q))
    at_rest, moving = (each.astype(number).astype(float) for each in encoders)
    watch.see(at_rest, 0 * dq[:50])
    assert np.isinf(list(watch.o.compared[2:4])).all()  # no step is known, and there is no contact
    watch.see(moving, dq, 50, 0.05 + np.append(T[:50] - 0.05, T))
    np.testing.assert_allclose(list(watch.o.step), STEPS, rtol=0, atol=5e-7)
    rounding = K**2 * (STEPS[:2] ** 2 + STEPS[2:] ** 2) / 12
    integration = np.array(list(watch.o.integration[0:2]))
    np.testing.assert_allclose(watch.S, np.diag(NOISE**2 + integration**2 + rounding), rtol=5e-3)


@pytest.mark.parametrize("bits", [8, 20])
def test_encoders_of_any_step_are_no_contact_and_a_large_push_is(bits: int) -> None:
    a, t = 2 * np.pi / 2**bits, np.arange(1000) * 1e-3
    for seed in range(2):
        rng, watch = np.random.default_rng(seed), Watch(step=[np.inf] * 4)
        q, dq = motion(rng.normal(size=10), t=t)
        watch.see(np.round(q / a) * a, dq, t=t)
        assert watch.contact.joints == 0, seed
        threshold = np.array(list(watch.o.compared[2:4]))
        q[:100, 2:] -= 1.5 * threshold / K + 2 * a
        watch.see(np.round(q[:100] / a) * a, dq[:100], t=1.0 + t)
        assert watch.contact.acting, seed


def test_a_state_that_repeats_under_a_new_stamp_changes_nothing() -> None:
    """It is as old as the last one: its motion would be missing, for as long as the robot does not stand still."""
    watch, clean, (q, dq) = Watch(), Watch(), motion(np.zeros(10))
    clean.see(q, dq)
    again = np.repeat(np.arange(len(T)), 2)
    watch.see(q[again], dq[again], t=T[again] + np.tile([0.0, 5e-4], len(T)))
    np.testing.assert_array_equal(watch.r, clean.r)
    np.testing.assert_array_equal(watch.S, clean.S)


def test_a_state_that_repeats_the_last_one_that_was_measured_has_no_torque_while_there_is_none() -> None:
    watch, (q, dq) = Watch(), motion(np.zeros(10))
    watch.see(q[:50], dq[:50])
    arrays = [watch.lib.ffi.from_buffer("double[]", each) for each in (q[49].copy(), dq[49].copy(), q[50] * np.nan)]
    assert not watch.lib.lib.fjr_watch_torque(watch.o, watch.contact, arrays[2], arrays[1], 50_000_000)
    assert not watch.lib.lib.fjr_watch_torque(watch.o, watch.contact, arrays[0], arrays[1], 51_000_000)


@pytest.mark.parametrize("jump", [-50.0, 0.15, 50.0])
def test_a_jump_of_the_clock_leaves_the_threshold_as_sharp_as_at_a_start(jump: float) -> None:
    """The observer restarts there: the time that the stamps skip is no error of its trapezoidal rule."""
    jumped, fresh, (q, dq) = Watch(), Watch(), motion(np.zeros(10))
    t = np.where(np.arange(len(T)) < 60, T, T + jump)
    jumped.see(q, dq, t=t)
    fresh.see(q[60:], dq[60:], t=T)
    np.testing.assert_allclose(jumped.r, fresh.r, rtol=0, atol=1e-13)
    np.testing.assert_allclose(jumped.S, fresh.S, rtol=1e-9)


@pytest.mark.parametrize("value", [1e10, -1e200, 1e308, np.nan])
@pytest.mark.parametrize("signal", [0, 1], ids=["position", "velocity"])
def test_a_value_that_no_sensor_measures_is_neither_contact_nor_hides_one(signal: int, value: float) -> None:
    t = np.arange(400) * 1e-3
    clean, watch, (q, dq) = Watch(), Watch(), motion(np.zeros(10), t=t)
    clean.see(q, dq, t=t)
    watch.see(q[:200], dq[:200], t=t)
    wrong = [q[200].copy(), dq[200].copy()]
    wrong[signal][1] = value
    arrays = [watch.lib.ffi.from_buffer("double[]", each) for each in wrong]
    assert not watch.lib.lib.fjr_watch_torque(watch.o, watch.contact, *arrays, 200_000_000)
    watch.see(q[201:], dq[201:], 201, t)
    assert not watch.contact.acting
    np.testing.assert_allclose(np.diag(watch.S), np.diag(clean.S), rtol=0.05)


def test_a_distance_that_rounding_has_lost_is_contact() -> None:
    watch = Watch()
    for k in range(0, 100, 11):
        watch.o.P[k] = -1e9  # no covariance; S has no square root
    watch.see(*motion(np.zeros(10)))
    assert watch.contact.acting


def test_contact_ends_once_it_has_been_away_for_a_while() -> None:
    watch, (position, velocity) = Watch(), motion(np.zeros(10), np.where(T[:, None] < 0.02, [3.0, 0.0], 0.0))
    watch.see(position, velocity)
    assert watch.contact.acting
    last = watch.contact.stamp
    for k in range(120, 420):
        watch.see(position[-1:], 0 * velocity[-1:] + 1e-9 * k, k)  # no state repeats
        last = max(last, watch.contact.stamp)
        assert watch.contact.acting == (k * 1_000_000 - last < QUIET)
    assert not watch.contact.acting


def test_contact_lasts_while_its_distance_exceeds_a_quarter_of_the_limit() -> None:
    ratios, rng = list[float](), np.random.default_rng(0)
    position, velocity = motion(np.zeros(10), np.where(T[:, None] < 0.02, [3.0, 0.0], 0.0))
    for push in (0.0, 0.2, 0.4, 0.8):
        watch = Watch()
        watch.see(position, velocity)
        rest = np.tile(position[-1] - np.array([0.0, 0.0, push, 0.0]) / K[0], (80, 1))
        watch.see(rest, 1e-9 * rng.normal(size=rest.shape), 0, T[-1] + 5e-3 * np.arange(1, 81))  # no state repeats
        ratios.append(float(watch.e @ np.linalg.solve(watch.S, watch.e) / watch.o.limit))
        assert watch.contact.acting == (ratios[-1] > 0.25), ratios
    assert min(ratios) < 0.25 < sorted(ratios)[-2] < 1.0


def test_learning_is_the_rule_of_bayes() -> None:
    """Every 25 samples; the oracle inverts the sum of all information. Contact is not learnt."""
    watch = Watch(25_000_000, stay=1.0, learned=0)
    position, velocity = motion(np.full(10, 0.5))
    information, vector = np.eye(10), np.zeros(10)
    for k in range(len(T)):
        watch.see(position[k : k + 1], velocity[k : k + 1], k)
        if k and k % 25 == 0:
            information += watch.Z.T @ np.diag(NOISE**-2) @ watch.Z
            vector -= watch.Z.T @ (watch.r / NOISE**2)
    P = np.linalg.inv(information)
    np.testing.assert_allclose(watch.array("P", 100).reshape(10, 10), P, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(watch.array("d", 10), P @ vector, rtol=1e-7, atol=1e-9)
    before = watch.array("d", 10)
    position[:, 2:] -= 5.0 / K
    watch.see(position, velocity, len(T))
    assert watch.contact.acting
    np.testing.assert_array_equal(watch.array("d", 10), before)
