# SPDX-License-Identifier: Apache-2.0
"""The law of measured velocities with symbolic gains, which may change while it runs."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import LOOP_NAMES, LOOPS, Arm, GainSet, planar, random_point
from core.oracles.properties import loop_of

PLANAR = planar("soft", (40.0, 25.0))
FULL = np.array([[3.0, 0.5], [0.5, 2.0]])
DIAGONAL = fjr.Gains(10.0, 20.0, 0.6, 15.0, 60.0, 0.3)
OTHER = fjr.Gains([8.0, 9.0], [16.0, 30.0], 0.4, 12.0, [40.0, 50.0], 0.2, Gamma_l=1.5, Gamma_m=[0.0, 2.0])


def measured(law: fjr.TrackingLaw, x: np.ndarray, jets: np.ndarray) -> tuple[np.ndarray, float]:
    velocity = np.concatenate(law.robot.velocities(x))
    return law.measured_command(x[: 2 * law.robot.n], velocity, jets)


@pytest.mark.parametrize(("arm", "gains"), LOOPS, ids=LOOP_NAMES)
def test_equals_the_law_and_its_storage_on_the_diagonal(arm: Arm, gains: GainSet) -> None:
    law = loop_of(arm, gains).law
    for seed in range(5):
        p = random_point(arm, seed, True)
        (u, V), e = measured(law, p.x, p.jets), law.evaluate(p.x, p.x, p.jets)
        np.testing.assert_allclose(u, e.u, rtol=1e-10, atol=1e-10 * np.max(np.abs(e.u)))
        assert pytest.approx(e.V, rel=1e-10) == V


def test_changed_gains_give_the_law_built_with_them_from_the_same_function() -> None:
    robot = fjr.planar_two_link()
    law = fjr.TrackingLaw(robot, DIAGONAL)
    other, wanted = law.with_gains(OTHER), fjr.TrackingLaw(robot, OTHER)
    assert other.measured_function is law.measured_function
    p = random_point(PLANAR, 3, True)
    seen = [measured(each, p.x, p.jets) for each in (other, wanted)]
    np.testing.assert_allclose(seen[0][0], seen[1][0], rtol=1e-12)
    assert pytest.approx(seen[1][1], rel=1e-12) == seen[0][1]
    np.testing.assert_allclose(measured(law, p.x, p.jets)[0], law.command(p.x, p.jets), rtol=1e-10)


def test_law_built_for_matrices_accepts_diagonal_gains() -> None:
    robot = fjr.planar_two_link()
    law = fjr.TrackingLaw(robot, fjr.Gains(10.0, 10 * FULL, FULL, 15.0, 20 * FULL, 0.1 * FULL)).with_gains(DIAGONAL)
    p = random_point(PLANAR, 4, True)
    np.testing.assert_allclose(
        measured(law, p.x, p.jets)[0], fjr.TrackingLaw(robot, DIAGONAL).command(p.x, p.jets), rtol=1e-10
    )


def test_law_built_for_diagonal_gains_refuses_matrices_and_every_law_refuses_invalid_gains() -> None:
    law = fjr.TrackingLaw(fjr.planar_two_link(), DIAGONAL)
    with pytest.raises(fjr.GainsError, match="K_ld has entries off the diagonal; expected a diagonal matrix"):
        law.with_gains(fjr.Gains(10.0, 20.0, FULL, 15.0, 60.0, 0.3))
    with pytest.raises(fjr.GainsError, match="K_ld"):
        law.with_gains(fjr.Gains(10.0, 20.0, -0.6, 15.0, 60.0, 0.3))
