# SPDX-License-Identifier: Apache-2.0
"""The reaction to contact around a stop, a resume and a start: nothing tracks against a contact that it has to heed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fjr_core.runtime.control_step import Command, ControlStep
from fjr_core.runtime.events import State
from tracking.tracked import LAW, MS, STILL, sample, settings, tracker_at

AT = 0.5  # rad
WEIGHT = LAW.robot.grad_P_l([AT])


def contact(tracker: ControlStep, acting: bool) -> None:
    """Let the observer of external torques have found contact at the last sample, or its end."""
    found = tracker.controller.contact
    found.joint, found.joints, found.value, found.limit, found.acting = 0, 1, -5.0, 2.0, acting


def at(tracker: ControlStep, k: int, dq: float = 0.0) -> Command:
    """Return the command of the sample after k ms, at AT."""
    command = tracker.command(sample(k * MS, AT, AT, dq), k * MS)
    assert command is not None
    return command


def stopped_in_contact(on_contact: str, **given: Any) -> ControlStep:
    """Return a tracker that has reacted to contact, which goes on, and then has stopped at a limit."""
    tracker = tracker_at(0, MS, on_contact=on_contact, link_velocity=1.0, on_stop="gravity_hold", **given)
    contact(tracker, True)
    at(tracker, 2)
    at(tracker, 3, dq=2.0)
    assert at(tracker, 4).state is State.STOPPED
    return tracker


def test_a_resume_in_contact_stops_again_and_is_announced_to_be_refused() -> None:
    tracker = stopped_in_contact("stop")
    for k in (5, 6):
        assert tracker.outside() == "contact of joint1: external torque = 5 N m; expected at most 2 N m"
        tracker.resume()
        assert at(tracker, k).state is State.STOPPED
    assert tracker.counters["stops: contact"] == 3
    assert "resumes" not in tracker.counters
    contact(tracker, False)
    assert tracker.outside() == ""
    tracker.resume()
    assert at(tracker, 7).state is State.JOINING


def test_a_resume_in_contact_yields_until_that_has_ended() -> None:
    tracker = stopped_in_contact("yield")
    assert tracker.outside() == ""
    tracker.resume()
    for k in range(5, 100):
        np.testing.assert_allclose(at(tracker, k).u, WEIGHT, rtol=1e-12)
    assert not tracker.reason
    contact(tracker, False)
    for k in range(100, 2000):
        command = at(tracker, k)
    assert command.state is State.TRACKING
    assert abs(command.u - WEIGHT) > 1.0


@pytest.mark.parametrize("on_contact", ["stop", "yield"])
def test_a_contact_that_ends_while_a_resume_waits_leaves_nothing_behind(on_contact: str) -> None:
    tracker, other = stopped_in_contact(on_contact), stopped_in_contact("report")
    for each in (tracker, other):
        contact(each, False)
        each.resume()
    for k in range(5, 2000):
        np.testing.assert_array_equal(at(tracker, k).u, at(other, k).u)


@pytest.mark.parametrize("on_contact", ["report", "stop", "yield"])
def test_a_contact_of_before_is_none_after_a_start(on_contact: str) -> None:
    tracker, new = stopped_in_contact(on_contact), tracker_at(on_contact=on_contact)
    tracker.start()
    tracker.events.clear()
    for k in range(10_000, 10_010):
        assert at(tracker, k).state is State.TRACKING
        np.testing.assert_array_equal(at(tracker, k).u, at(new, k).u)
    assert not tracker.events


def test_a_contact_after_a_start_is_heeded() -> None:
    tracker = stopped_in_contact("stop")
    tracker.start()
    at(tracker, 10_000)
    contact(tracker, True)
    assert at(tracker, 10_001).state is State.STOPPED


@pytest.mark.parametrize("before", ["report", "yield"])
@pytest.mark.parametrize("after", ["report", "stop", "yield"])
def test_a_reaction_that_is_chosen_in_contact_counts_at_once(before: str, after: str) -> None:
    tracker = tracker_at(0, MS, on_contact=before)
    contact(tracker, True)
    at(tracker, 2)
    tracker.apply(settings(**STILL, on_contact=after))
    command = at(tracker, 3)
    assert (command.state is State.STOPPED) == (after == "stop")
    assert bool(tracker.controller.supervisor.yielding) == (after == "yield")
    if before == "yield" and after == "report":
        np.testing.assert_allclose(command.u, WEIGHT, rtol=1e-9)  # a transition begins, without a step
        assert tracker.counters["recoveries"] == 1
    contact(tracker, False)
    for k in range(4, 2000):
        command = at(tracker, k)
    assert command.state is (State.STOPPED if after == "stop" else State.TRACKING)
