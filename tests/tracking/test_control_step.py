# SPDX-License-Identifier: Apache-2.0
"""The control step in closed loop: efforts, limits, changed gains, events, for any input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
import own_code
from fjr_core.motions.point_to_point import Hold
from fjr_core.robust.law import Robust
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import STATES, State
from tracking.tracked import (
    LAW,
    MS,
    PERIOD,
    SECOND,
    SINE,
    TWO,
    Loop,
    kinds,
    sample,
    settings,
    tracker_at,
)

OWN = fjr.PythonLaw(own_code.Pd(LAW.robot), LAW.robot)


@pytest.mark.parametrize("law", [LAW, OWN], ids=["compiled", "in Python"])
def test_effort_without_options_is_bit_identical_to_the_law(law: fjr.TrackingLaw | fjr.PythonLaw) -> None:
    loop = Loop(law, SINE, settings(), law.robot.state(0.5, 0.5, 0.0, 0.0))
    for k in range(300):
        x = loop.x
        dq_l, dq_m = law.robot.velocities(x)
        command = loop.step()
        jets = SINE.jets(k * PERIOD * 1e-9)
        u, V = law.measured_command(x[:2], np.concatenate([dq_l, dq_m]), jets)
        assert (command.u == u).all()
        assert command.V == V or law is OWN
        assert (command.jets == jets).all()
        assert command.state is State.TRACKING
    assert not loop.tracker.counters
    assert not loop.tracker.events
    assert loop.tracker.bound_start == (None if law is OWN else SECOND)


def test_a_command_holds_the_state_at_which_its_law_was_evaluated() -> None:
    tracker = ControlStep(TWO, Hold([0.0, 0.0]), settings(2))
    command = tracker.command(sample(0, [0.1, 0.2], [0.3, 0.4], [0.5, 0.6], [0.7, 0.8]), 0)
    np.testing.assert_array_equal(command.position, [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(command.velocity, [0.5, 0.6, 0.7, 0.8])


def test_limits_that_are_not_reached_change_nothing() -> None:
    wide = settings(
        effort=1e3,
        effort_rate=1e9,
        link_position_lower=-9.0,
        motor_position_upper=9.0,
        link_velocity=99.0,
        deflection=9.0,
        tracking_error=9.0,
        start_error=9.0,
        state_timeout=1.0,
    )
    loops = [Loop(LAW, SINE, s, LAW.robot.state(0.0, 0.0, 0.0, 0.0)) for s in (settings(), wide)]
    for loop in loops:
        first = LAW.measured_command(np.zeros(2), np.zeros(2), SINE.jets(0.0))[0]
        loop.tracker.controller.limits.sent = first.tolist()  # from which the rate counts
        loop.run(0.2)
    np.testing.assert_array_equal(loops[0].efforts, loops[1].efforts)


@pytest.mark.parametrize("bad", [float("nan"), -1e308])
def test_a_non_finite_effort_is_replaced_and_changes_no_state(bad: float) -> None:
    tracker = ControlStep(LAW, SINE, settings(on_stop="gravity_hold"))
    twin = ControlStep(LAW, SINE, settings(on_stop="gravity_hold"))
    for t in (tracker, twin):
        t.command(sample(SECOND, 0.5, 0.5), SECOND)
    for k in (1, 2):
        command = tracker.command(sample(SECOND + k * MS, bad, 0.5, bad), SECOND + k * MS)
        np.testing.assert_allclose(command.u, 0.8 * np.sin(0.5), rtol=1e-12)
    tracker.use(LAW)
    good = [t.command(sample(SECOND + 3 * MS, 0.5, 0.5), SECOND + 3 * MS) for t in (tracker, twin)]
    np.testing.assert_array_equal(good[0].u, good[1].u)
    assert tracker.counters == {"efforts not finite": 2, "gains changed": 1}
    assert kinds(tracker) == ["efforts not finite", "gains changed"]


def test_invalid_first_sample_does_not_start_the_reference() -> None:
    tracker = ControlStep(LAW, SINE, settings())
    command = tracker.command(sample(0, float("nan"), 0.5), 0)
    assert not command.u.any()
    assert tracker.state is State.WAITING
    first = tracker.command(sample(100 * MS, 0.5, 0.5), 100 * MS)
    np.testing.assert_array_equal(first.jets, SINE.jets(0.0))


def test_changed_gains_act_from_the_next_sample_and_restart_the_certificate() -> None:
    law = LAW.with_gains(replace(fjr.PAPER_GAINS, Lambda_l=5.0))
    loop = Loop(LAW, SINE, settings(), LAW.robot.state(0.5, 0.5, 0.0, 0.0))
    loop.run(0.05)
    assert loop.tracker.bound_start == SECOND
    loop.tracker.use(law)
    assert loop.tracker.bound_start is None
    x = loop.x
    command = loop.step()
    u, V = law.measured_command(x[:2], np.concatenate(law.robot.velocities(x)), command.jets)
    assert command.u == u
    assert (loop.tracker.bound_start, command.V) == (SECOND + 50 * MS, V)
    assert kinds(loop.tracker) == ["gains changed"]


BEYOND_DOUBLES = fjr.Gains(Lambda_l=1e200, Pi_l=1e100, K_ld=1.0, Lambda_m=1e200, Pi_m=1e100, K_md=1.0)


@pytest.mark.parametrize(("name", "value"), [("Pi_l", 1e160), ("Lambda_m", 1e300), ("K_md", 1e170)])
def test_gains_without_a_finite_effort_are_refused_and_the_law_is_kept(name: str, value: float) -> None:
    tracker, twin = tracker_at(0), tracker_at(0)
    law = LAW.with_gains(replace(fjr.PAPER_GAINS, **{name: value}))
    with pytest.raises(fjr.GainsError, match="an effort that is not finite; expected smaller gains"):
        tracker.use(law)
    with pytest.raises(fjr.GainsError, match=r"'gains\.\*' and 'robust\.\*' give an effort that is not finite"):
        tracker_at(0, robust=Robust(integral_gain=4.0)).use(LAW.with_gains(BEYOND_DOUBLES))
    commands = [t.command(sample(MS, 0.5, 0.5), MS) for t in (tracker, twin)]
    np.testing.assert_array_equal(commands[0].u, commands[1].u)
    assert not tracker.counters
    with pytest.raises(fjr.GainsError, match="not finite"):
        ControlStep(law, SINE, settings())


def test_bound_of_the_certificate_continues_while_only_the_law_acts() -> None:
    loop = Loop(LAW, SINE, settings(ramp_time=0.05), LAW.robot.state(0.5, 0.5, 0.0, 0.0))
    loop.run(0.05)
    assert loop.tracker.bound_start is None
    beta, V = LAW.rate().beta, []
    for k in range(400):
        command = loop.step()
        V.append(command.V)
        assert loop.tracker.bound_start == SECOND + 50 * MS
        bound = V[0] * np.exp(-2 * beta * k * 1e-3)
        assert bound * 1.05 >= V[k]


def test_states_have_the_order_of_the_enumeration() -> None:
    elements = tracker_at().ffi.typeof("enum fjr_state").elements
    assert [elements[k] for k in range(len(elements))] == [f"FJR_{state.name}" for state in STATES]
