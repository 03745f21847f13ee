# SPDX-License-Identifier: Apache-2.0
"""The error system is the plant under a held effort, seen in the errors of the law."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.motions.sine import MultiSine
from fjr_core.numerics.intervals import Interval
from fjr_proofs.sampled_contraction.error_system import ErrorSystem
from fjr_proofs.sampled_contraction.sine_jets import sine_jets
from proofs.sampled_contraction.loops import CUBIC, derivatives, errors, joint, state, two_link

LAWS = {"joint": joint(), "cubic": joint(CUBIC), "two links": two_link()}
STEP = 1e-5


def reference_of(law: fjr.TrackingLaw) -> fjr.Sine:
    return fjr.Sine([0.5, 0.7][: law.robot.n], [2.0, 3.0][: law.robot.n], 0.3)


@pytest.mark.parametrize("name", LAWS)
def test_field_is_the_derivative_of_the_errors_along_the_plant(name: str) -> None:
    law = LAWS[name]
    system, plant, reference, n = ErrorSystem(law), fjr.Plant(law.robot), reference_of(law), law.robot.n
    rng = np.random.default_rng(2)
    for t in rng.uniform(0, 6, 5):
        chi = rng.uniform(-0.2, 0.2, 5 * n)
        x = state(system, chi, reference, t)
        assert errors(law, x, reference.jets(t)) == pytest.approx(chi[: 4 * n], abs=1e-12)
        held = law.command(x, reference.jets(t)) + chi[4 * n :]
        moved = [plant.step(x, held, dt) for dt in (-STEP, STEP)]
        ends = [
            np.append(errors(law, y, jets), held - law.command(y, jets))
            for y, jets in zip(moved, reference.jets(np.array([t - STEP, t + STEP])), strict=True)
        ]
        expected = (ends[1] - ends[0]) / (2 * STEP)
        found = system.field(chi, derivatives(reference, t)).full().ravel()
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("name", LAWS)
def test_jacobian_and_curvature_enclose_differences_of_the_field(name: str) -> None:
    law = LAWS[name]
    system, reference, m = ErrorSystem(law), reference_of(law), 5 * law.robot.n
    rng = np.random.default_rng(4)
    chi, t, radius = rng.uniform(-0.1, 0.1, m), 1.3, 1e-3
    box = Interval(chi[:, None], np.full((m, 1), radius))
    jets = sine_jets(reference, Interval(np.array([t]), np.array([radius])), 7)
    D, (H, by_time) = system.jacobian(box, jets)[0], system.curvature(box, jets)

    def slope(at: np.ndarray, when: float) -> np.ndarray:
        d = 1e-6 * np.eye(m)
        at_jets = derivatives(reference, when)
        columns = [system.field(at + e, at_jets).full() - system.field(at - e, at_jets).full() for e in d]
        return np.hstack(columns)[system.pattern] / 2e-6

    for _ in range(10):
        inside, when = chi + radius * rng.uniform(-1, 1, m), t + radius * rng.uniform(-1, 1)
        there, centre = slope(inside, when), slope(chi, t)
        tolerance = 1e-6 * np.abs(centre).max()
        assert np.all(np.abs(there - D.mid[:, 0]) <= D.rad[:, 0] + tolerance)
        change = inside - chi
        expected = np.tensordot(change, H.mid[:, :, 0], axes=1) + (when - t) * by_time.mid[:, 0]
        reach = np.tensordot(np.abs(change), H.rad[:, :, 0], axes=1) + abs(when - t) * by_time.rad[:, 0]
        assert np.all(np.abs(there - centre - expected) <= reach + tolerance)


def test_derivatives_of_sums_of_sines_are_enclosed() -> None:
    reference = MultiSine([[0.2, 0.1], [0.3, 0.4]], [[1.0, 2.0], [3.0, -4.0]], [[0.1, 0.2], [0.3, 0.4]], [0.5, -0.5])
    t = np.linspace(0, 7, 40)
    found = sine_jets(reference, Interval(t, np.full_like(t, 1e-3)), 7)
    for when in (t, t + 1e-3, t - 4e-4):
        jets = reference.jets(when).reshape(len(t), 10).T
        assert np.all(np.abs(jets - found.mid[:10]) <= found.rad[:10] + 1e-14 * np.abs(jets))
    later = (
        sine_jets(reference, Interval.exact(t + 1e-5), 7).mid - sine_jets(reference, Interval.exact(t - 1e-5), 7).mid
    )
    assert later[:12] / 2e-5 == pytest.approx(found.mid[2:], abs=1e-5 * np.abs(found.mid).max())
