# SPDX-License-Identifier: Apache-2.0
"""After a stop the motors are damped by their velocities as far as their positions confirm these: none is driven."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fjr_core.motions.point_to_point import Hold
from fjr_core.numerics.checks import Array
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.library import constant
from tracking.tracked import MS, SECOND, TWO, Loop, moving_arm, sample, settings

AGREEMENT, ENOUGH = constant("AGREEMENT"), constant("ENOUGH")  # s, share
FAULTS: dict[str, Callable[[Array], Array]] = {
    "no velocity": lambda dq: 0 * dq,
    "wrong signs": lambda dq: -dq,
    "a wrong sign": lambda dq: dq * [-1.0, 1.0],
    "another wrong sign": lambda dq: dq * [1.0, -1.0],
    "a gain of 10": lambda dq: 10 * dq,
    "a gain of -10": lambda dq: -10 * dq,
    "exchanged": lambda dq: dq[::-1],
}


def share(t: Array, q: Array, dq: Array) -> float:
    """Return the factor by least squares over all intervals, older ones with the weight exp(-age / AGREEMENT)."""
    mean, slope = (dq[1:] + dq[:-1]) / 2, np.diff(q) / np.diff(t)
    weight = np.exp((t[1:] - t[-1]) / AGREEMENT) * np.diff(t)
    return float(np.clip((weight * mean) @ slope / (weight @ mean**2) / ENOUGH, 0.0, 1.0))


@pytest.mark.parametrize("seed", range(3))
def test_the_factor_of_a_velocity_is_that_of_least_squares_from_its_slope(seed: int) -> None:
    rng, weight = np.random.default_rng(seed), np.linalg.solve(TWO.robot.B_m, TWO.robot.grad_P_l([0.4, 0.9]))
    given = settings(2, on_stop="gravity_hold", link_position_upper=0.1, wiring_check=False)
    tracker = ControlStep(TWO, Hold([0.0, 0.0]), given)
    t, q = np.cumsum(rng.uniform(5e-4, 2e-3, 80)), np.cumsum(rng.normal(0, 1e-3, (80, 2)), axis=0)
    dq = np.gradient(q, t, axis=0) * rng.uniform(-1, 3, 2) + rng.normal(0, 0.3, (80, 2))
    stamps = np.round(t * 1e9).astype(np.int64)
    for k in range(80):
        u = tracker.command(sample(int(stamps[k]), [0.4, 0.9], q[k], 0.0, dq[k]), int(stamps[k])).u
        if k < 2:
            continue
        factors = [share(stamps[:k] * 1e-9, q[:k, i], dq[:k, i]) for i in range(2)]
        damping = TWO.robot.B_m @ (weight - u)
        np.testing.assert_allclose(damping, TWO.gains.K_md @ (factors * dq[k]), rtol=1e-6, atol=1e-12)


def peak(fault: Callable[[Array], Array], seconds: float = 1.0) -> float:
    """Return the largest motor speed [rad/s] after a stop of the moving arm, from when on its velocities are wrong."""
    given: dict[str, Any] = {"on_stop": "gravity_hold", "effort": [60.0, 30.0], "wiring_check": False}
    loop: Loop = moving_arm(**given)
    loop.run(0.6)
    loop.tracker.apply(settings(2, link_velocity=1e-9, **given))
    right, speeds = loop.sample, []
    loop.sample = lambda: replaced(right(), fault)  # type: ignore[method-assign]
    for _ in range(round(seconds * SECOND / MS)):
        loop.step()
        speeds.append(np.abs(loop.robot.velocities(loop.x)[1]).max())
    return float(max(speeds))


def replaced(state: Any, fault: Callable[[Array], Array]) -> Any:
    state.dq_m = fault(state.dq_m)
    return state


@pytest.mark.parametrize("fault", [name for name in FAULTS if name != "no velocity"])
def test_a_wrong_velocity_drives_no_motor_faster_than_gravity_compensation_alone(fault: str) -> None:
    assert peak(FAULTS[fault]) < 1.1 * peak(FAULTS["no velocity"])


def test_values_that_overflow_do_not_end_the_damping() -> None:
    tracker = ControlStep(TWO, Hold([0.0, 0.0]), settings(2, on_stop="gravity_hold", link_position_upper=0.1))
    for k in range(40):
        speed = 1e300 if k == 20 else 0.5
        u = tracker.command(sample(k * MS, [0.4, 0.9], 0.5e-3 * k, 0.0, speed), k * MS).u
    expected = tracker.stop_effort() - np.linalg.solve(TWO.robot.B_m, np.full(2, 0.5) @ TWO.gains.K_md)
    np.testing.assert_allclose(u, expected, rtol=1e-9)
