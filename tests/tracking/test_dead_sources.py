# SPDX-License-Identifier: Apache-2.0
"""States of a source that is dead, or of two: what is refused or stops, and what every healthy robot may send."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import settings as tried
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid

import fjr_core as fjr
from fjr_core.motions.point_to_point import Hold
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from fjr_core.runtime.library import constant
from fjr_core.runtime.measurement_model import Measurement
from tracking.tracked import LAW, MS, SECOND, STILL, TWO, Loop, bare_sample, sample, settings, tracker_at

UNSEEN, UNCHANGED, COUNTED = constant("UNSEEN"), int(constant("UNCHANGED")), constant("COUNTED")
TIMING, LEAST = constant("TIMING"), constant("LEAST")
FIRST = 5 * SECOND


def healthy(tracker: ControlStep, stamp: int, *parts: Any) -> bool:
    """Send a state at its stamp; return whether it is not frozen."""
    before = tracker.counters["states frozen"]
    command = tracker.command(sample(stamp, *parts), stamp)
    frozen = tracker.counters["states frozen"] - before
    assert frozen or command is not None
    return not frozen


def two(simulated: bool = False, **given: Any) -> ControlStep:
    return ControlStep(TWO, Hold([0.0, 0.0]), settings(2, **STILL, **given), simulated=simulated)


@pytest.mark.parametrize("stop", ["zero", "gravity_hold"])
def test_frozen_states_have_the_stop_effort_once_and_the_next_other_one_is_a_recovery(stop: str) -> None:
    """The last effort is no effort to hold for state_timeout: the law has computed it from states that were frozen."""
    tracker = ControlStep(LAW, fjr.Sine(1.0, 1.0), settings(on_stop=stop))
    sent = [tracker.command(sample(FIRST + k * MS, 0.5, 0.5, 1.0), FIRST + k * MS) for k in range(100)]
    assert [command is not None for command in sent] == [k <= 23 for k in range(100)]
    assert [(command.u == tracker.stop_effort()).all() for command in sent[:24]] == [k == 23 for k in range(24)]
    assert [event.kind for event in tracker.events if event.level == "error"] == ["states frozen"]
    again = tracker.command(sample(FIRST + 100 * MS, 0.51, 0.5, 1.0), FIRST + 100 * MS)
    assert again.state is State.JOINING
    assert tracker.events[-1].sentence.endswith("; a gap of 0.078 s without states had ended")


def test_one_state_sent_twice_is_not_frozen_at_any_rate() -> None:
    tracker = two()
    for k in range(20):
        assert healthy(tracker, FIRST + 40 * k * MS, 0.2 * (k // 2), 0.2 * (k // 2), 2.5)


speeds = st.floats(1.2 * UNSEEN / COUNTED, 5.0)
signs = st.sampled_from([-1.0, 1.0])


@tried(max_examples=40)
@given(joint=st.integers(0, 1), speed=speeds, sign=signs, timeout=st.floats(0.002, 5.0), ms=st.integers(1, 10))
def test_a_joint_that_stands_still_at_a_velocity_is_refused_once_it_must_have_moved_whatever_the_others_do(
    joint: int, speed: float, sign: float, timeout: float, ms: int
) -> None:
    """As where one drive has left the bus, and its last values stay in the process data."""
    tracker = two(simulated=True, state_timeout=timeout)
    late = max(UNCHANGED * 1e-9 + 2e-3 * ms, UNSEEN / speed)
    dq = np.zeros(2)
    dq[joint] = sign * speed
    for k in range(0, 700, ms):
        moving = np.full(2, 1e-3 * k)
        moving[joint] = 0.1
        refused = not healthy(tracker, FIRST + k * MS, moving, moving, dq)
        assume(abs(k * 1e-3 - late) > 1e-9)
        assert refused == (k * 1e-3 > late)
        if refused:
            break
    else:
        pytest.fail("never refused")
    event = next(event for event in tracker.events if event.level == "error")
    assert f"the values of joint{joint + 1} repeat" in event.sentence


@tried(max_examples=40)
@given(
    period=st.integers(500_000, 50 * MS),
    every=st.integers(1, 20 * MS),
    resolution=st.sampled_from([0.0, 1e-6, 4e-3]),
    amplitude=st.floats(0.0, 2.0),
    rate=st.floats(0.1, 6.0),
    offset=st.floats(-0.005, 0.005),
    start=st.integers(0, 100),
)
def test_no_healthy_encoder_is_frozen_or_jumps(
    period: int, every: int, resolution: float, amplitude: float, rate: float, offset: float, start: int
) -> None:
    """Up to 20 ms slower than the states, coarse, with an offset of the velocity, at rest or fast, also at its turn."""
    tracker = two(link_velocity=np.full(2, 1.001 * amplitude * rate + 0.01))
    for stamp in range(FIRST + start * SECOND, FIRST + start * SECOND + 600 * MS, period):
        t = (stamp - stamp % every) * 1e-9
        q, dq = amplitude * math.sin(rate * t), amplitude * rate * math.cos(rate * t)
        if resolution:
            q, dq = resolution * round(q / resolution), 0.01 * round(dq / 0.01)
        assert healthy(tracker, stamp, [q, 0.0], [q, 0.0], [dq + offset, offset])
    assert tracker.state is not State.STOPPED


@pytest.mark.parametrize("simulated", [False, True])
@pytest.mark.parametrize(("reference", "given"), [(Hold([0.0]), {}), (fjr.Sine(0.3, 1.0), STILL)])
def test_an_arm_at_rest_or_held_by_brakes_is_answered_without_end(
    reference: fjr.Reference, given: dict[str, Any], simulated: bool
) -> None:
    """Exact zeros in a simulation without noise; a small offset of the velocity, for minutes and after jumps."""
    for offset in (0.0, 0.99 * UNSEEN / COUNTED):
        tracker = ControlStep(LAW, reference, settings(**given), simulated=simulated)
        for k in range(1000):
            assert healthy(tracker, FIRST + k * 200 * MS, 0.0, 0.0, offset)


class Measured(Loop):
    """A loop from rest at q with encoders of so many bits; the driver repeats the first values for `frozen` states."""

    def __init__(self, law: fjr.TrackingLaw, q: Any, bits: int, frozen: int, **given: Any) -> None:
        robot = law.robot
        x0 = robot.state(q, q + np.linalg.solve(robot.K, robot.grad_P_l(q)), np.zeros(robot.n), np.zeros(robot.n))
        super().__init__(law, Hold(q), settings(robot.n, **given), x0)
        self.bits, self.frozen, self._first = bits, frozen, super().sample()

    def sample(self) -> Any:
        state = super().sample() if self.frozen <= 0 else sample(self.now, *list(vars(self._first).values())[1:])
        self.frozen -= 1
        step = 2 * np.pi / 2.0**self.bits
        q_l, q_m = (step * np.round(each / step) for each in (state.q_l, state.q_m))
        return sample(self.now, q_l, q_m, *(0.01 * np.round(each / 0.01) for each in (state.dq_l, state.dq_m)))


@pytest.mark.parametrize("bits", [10, 40])
@pytest.mark.parametrize(("law", "q"), [(LAW, np.array([0.5])), (TWO, np.array([0.3, 0.2]))], ids=["paper", "two"])
def test_a_driver_that_freezes_at_rest_stops_the_arm_before_it_moves_faster_than_its_reference(
    law: fjr.TrackingLaw, q: Any, bits: int
) -> None:
    """By the tracking error of 0.25 rad the link of the paper's joint would have 54 rad/s."""
    loop = Measured(law, q, bits, frozen=10_000)
    loop.run(0.1)
    loop.tracker.follow(fjr.Sine(np.full(law.robot.n, 0.6), np.full(law.robot.n, 2.0), offset=q))
    while loop.tracker.state is not State.STOPPED and loop.now < 3 * SECOND:
        loop.step()
    assert np.abs(loop.robot.velocities(loop.x)[0]).max() < 2.0
    assert loop.tracker.reason.startswith("stopped: no motion of ")
    assert loop.tracker.reason.endswith(" s (driver, brake, drive or network?)")
    for _ in range(2):
        assert (loop.step().u == loop.tracker.stop_effort()).all()
        loop.tracker.resume()
        loop.run(1.0)
        assert loop.tracker.state is State.STOPPED, "the driver is still frozen"


def test_a_motor_without_motion_stops_the_arm_once_the_effort_must_have_moved_it() -> None:
    """It stood without effort. Friction is known after the first states; then the way is that of a free motor."""
    robot, efforts = fjr.single_link(motor_inertia=1.0), [0.0]
    tracker = ControlStep(fjr.TrackingLaw(robot, fjr.PAPER_GAINS), fjr.Sine(0.3, 2.0, offset=0.5), settings())
    while not tracker.reason and len(efforts) < 500:
        stamp = FIRST + len(efforts) * MS
        efforts.append(float(tracker.command(sample(stamp, 0.5, 0.5), stamp).u[0]))
    friction = constant("DRIVEN") * tracker.controller.wiring.constant[0]
    acceleration = np.maximum(np.abs(efforts[int(constant("FEWEST")) - 1 : -1]) - friction, 0.0)
    way = cumulative_trapezoid(cumulative_trapezoid(acceleration, dx=1e-3, initial=0.0), dx=1e-3, initial=0.0)
    assert len(way) > 1.3 * UNCHANGED / MS
    assert way[-1] == pytest.approx(UNSEEN, rel=0.1)


def test_a_gear_of_the_motor_changes_no_instant_of_a_stop_without_motion() -> None:
    """The spring balances most of the effort for some time, so that its torque counts."""
    stops = []
    for ratio in (1.0, -100.0):
        measured, swing = Measurement(1, gear_ratio=ratio), fjr.Sine(0.3, 2.0, offset=0.5)
        tracker, k = ControlStep(LAW, swing, settings(), measurement=measured), 0
        while not tracker.reason and k < 200:
            tracker.command(sample(FIRST + k * MS, 0.5, 0.55 * ratio, 0.0), FIRST + k * MS)
            k += 1
        stops.append(k * MS)
    assert UNCHANGED < stops[0] == stops[1] < 200 * MS


def test_a_stop_at_the_start_names_the_network_as_commands_may_not_arrive() -> None:
    """Over a lossy network states may come before the robot knows of the controller."""
    tracker = ControlStep(LAW, fjr.Sine(1.0, 1.0), settings())
    for k in range(100):
        tracker.command(sample(FIRST + k * MS, 0.5, 0.5, 0.0), FIRST + k * MS)
    assert tracker.reason.startswith("stopped: no motion of ")
    assert tracker.reason.endswith("; its values have not changed for 0.023 s (driver, brake, drive or network?)")


@pytest.mark.parametrize("bits", [9, 40])
@pytest.mark.parametrize("speed", [1e-3, 0.05, 2.0])
def test_coarse_encoders_of_an_arm_that_begins_to_move_are_not_frozen(speed: float, bits: int) -> None:
    q = np.array([0.3, 0.2])
    loop = Measured(TWO, q, bits, frozen=0, link_velocity=np.full(2, 3.0))
    loop.run(0.1)
    loop.tracker.follow(fjr.Sine(np.full(2, 0.5), np.full(2, speed), offset=q))
    loop.run(1.5)
    assert not loop.tracker.reason
    assert not loop.tracker.counters["states frozen"]


def test_an_observer_of_the_velocities_refuses_no_repeated_position() -> None:
    tracker = ControlStep(LAW, Hold([0.5]), settings(), fjr.VelocityObserver(LAW.robot, 150.0))
    for k in range(100):
        assert tracker.command(bare_sample(FIRST + k * MS), FIRST + k * MS) is not None


def test_a_simulation_that_starts_again_with_the_same_values_is_answered_at_once() -> None:
    tracker = two(simulated=True)
    for start in (FIRST, SECOND, 0):
        assert all(healthy(tracker, start + k * MS, 0.1, 0.1, 2.0) for k in range(15))


def test_a_tracking_error_of_a_joint_whose_values_do_not_change_says_so() -> None:
    """A driver that froze at rest, a closed brake or a drive that is off: the reference moves, the joint does not."""
    tracker = ControlStep(LAW, fjr.Sine(0.3, 1.0), settings(tracking_error=0.1, **STILL))
    for k in range(600):
        healthy(tracker, FIRST + k * MS, 0.0, 0.0)
    assert "; its values have not changed for 0.34 s (driver, brake, drive or network?)" in tracker.reason
    loop = Loop(LAW, fjr.Sine(0.3, 1.0), settings(tracking_error=0.1), LAW.robot.state(0.15, 0.15, 0.0, 0.0))
    loop.run(0.1)
    assert "tracking error" in loop.tracker.reason
    assert "have not changed" not in loop.tracker.reason


def test_frozen_states_are_said_again_after_the_next_activation() -> None:
    tracker = tracker_at(FIRST)
    for k in range(60):
        if k == 30:
            tracker.start()
        healthy(tracker, FIRST + k * MS, 0.5, 0.5, 1.0)
    assert [event.kind for event in tracker.events].count("states frozen") == 2


@tried(max_examples=40)
@given(
    speed=st.floats(0.1, 6.0),
    errors=st.lists(st.floats(-TIMING / 2, TIMING / 2), min_size=20, max_size=20),
    gaps=st.lists(st.integers(1, 90), min_size=20, max_size=20),
)
def test_a_joint_at_its_velocity_limit_does_not_jump_whenever_its_states_are_stamped(
    speed: float, errors: list[float], gaps: list[int]
) -> None:
    """Also in a burst: stamps that follow each other at once, of positions that were read earlier."""
    tracker, stamp, t = tracker_at(link_velocity=speed), FIRST, FIRST * 1e-9
    for error, gap in zip(errors, gaps, strict=True):
        t += gap * 1e-3
        stamp = max(round((t + error) * 1e9), stamp + 1)
        q = 0.999 * speed * (t - FIRST * 1e-9)
        tracker.command(sample(stamp, q, q, 0.999 * speed), stamp)
    assert not tracker.counters["stops: position jump"]


@tried(max_examples=40)
@given(joint=st.integers(0, 1), sign=signs, speed=st.floats(0.0, 5.0), ms=st.integers(1, 90), more=st.floats(1.01, 1e6))
def test_a_link_that_moved_further_than_its_limit_allows_stops(
    joint: int, sign: float, speed: float, ms: int, more: float
) -> None:
    tracker, jump = two(link_velocity=np.full(2, speed)), np.zeros(2)
    assert healthy(tracker, FIRST, 0.0, 0.0)
    jump[joint] = sign * more * max(speed * (ms * 1e-3 + TIMING), LEAST)
    healthy(tracker, FIRST + ms * MS, jump, 0.0)
    beyond = "at most " if sign > 0 else "at least -"
    said = f"position jump of joint{joint + 1}: change of q_l = {jump[joint]:.6g} rad; expected {beyond}"
    assert tracker.reason.startswith(f"stopped: {said}")


@pytest.mark.parametrize("broken", [(math.nan, 0.0, 0.0), (7.0, math.nan, 0.0), (7.0, 0.0, math.nan)])
def test_a_state_that_is_not_finite_does_not_hide_a_jump(broken: tuple[float, ...]) -> None:
    tracker = tracker_at(FIRST, link_velocity=2.0)
    healthy(tracker, FIRST + MS, *broken)
    healthy(tracker, FIRST + 2 * MS, 7.0, 0.0)
    assert tracker.counters["stops: position jump"] == 1
