# SPDX-License-Identifier: Apache-2.0
"""Exchanged joints and wrong signs are named in the first samples; the check ends when all joints follow."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import WiringFault
from fjr_monitor.diagnosis.fault_isolation import WiringCheck

PERIOD, SAMPLES = 1e-3, 60
MODEL = fjr.planar_two_link()
Change = Callable[[Array], Array]


def same(values: Array) -> Array:
    return values


@cache
def law() -> fjr.TrackingLaw:
    return fjr.TrackingLaw(MODEL, fjr.synthesize(MODEL, 8.0, PERIOD))


def checked(
    encoder: Change = same, velocity: Change = same, effort: Change = same
) -> tuple[WiringFault | None, int, WiringCheck]:
    """Run the loop and return the fault, the number of samples until it was found, and the check."""
    plant, check = fjr.Plant(MODEL), WiringCheck(MODEL)
    reference = fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0])
    start = np.random.default_rng(3).uniform(-0.1, 0.1, 2)
    x = MODEL.state(start, start, np.zeros(2), np.zeros(2))
    for k in range(SAMPLES):
        q, dq = encoder(x[:4]), velocity(encoder(np.concatenate(MODEL.velocities(x))))
        fault = check.see(k * PERIOD, q, dq)
        if fault is not None or check.done:
            return fault, k + 1, check
        u = law().measured_command(q, dq, reference.jets(k * PERIOD))[0]
        check.sent(u)
        for _ in range(4):
            x = plant.step(x, effort(u), PERIOD / 4)
    return None, SAMPLES, check


def flip(size: int, at: int) -> Change:
    return lambda values: np.where(np.arange(size) == at, -values, values)


def exchange(*order: int) -> Change:
    return lambda values: values[list(order)]


@pytest.mark.parametrize(
    ("wrong", "fault"),
    [
        ({"effort": exchange(1, 0)}, WiringFault("efforts exchanged", (0, 1), "motor")),
        ({"effort": flip(2, 0)}, WiringFault("effort sign", (0,), "motor")),
        ({"effort": flip(2, 1)}, WiringFault("effort sign", (1,), "motor")),
        ({"effort": np.negative}, WiringFault("effort sign", (0, 1), "motor")),
        ({"encoder": flip(4, 0)}, WiringFault("encoder sign", (0,), "link")),
        ({"encoder": flip(4, 3)}, WiringFault("encoder sign", (1,), "motor")),
        ({"encoder": exchange(0, 1, 3, 2)}, WiringFault("encoders exchanged", (0, 1), "motor")),
        ({"velocity": flip(4, 1)}, WiringFault("velocity sign", (1,), "link")),
        ({"velocity": flip(4, 2)}, WiringFault("velocity sign", (0,), "motor")),
        ({"velocity": exchange(0, 1, 2, 2)}, WiringFault("velocity of another joint", (1, 0), "motor")),
    ],
    ids=lambda value: str(value.kind) if isinstance(value, WiringFault) else "",
)
def test_each_fault_is_named_within_twenty_samples(wrong: dict[str, Change], fault: WiringFault) -> None:
    found, samples, _ = checked(**wrong)
    assert found == fault
    assert samples <= 21  # the state after the twentieth command


def test_check_ends_when_all_joints_follow() -> None:
    fault, samples, check = checked()
    assert fault is None
    assert check.done
    assert samples <= 21


def test_check_continues_without_motion() -> None:
    check = WiringCheck(MODEL)
    for k in range(200):
        assert check.see(k * PERIOD, np.zeros(4), np.zeros(4)) is None
        check.sent(np.zeros(2))
    assert not check.done
