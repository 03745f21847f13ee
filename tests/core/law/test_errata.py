# SPDX-License-Identifier: Apache-2.0
"""The equations as printed fail the tests that the corrected ones pass (docs/paper_map.md).

Eq. (49) is tested in stability/test_contraction.py, next to the corrected one.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import FULL, Arm, GainSet, Point, full, linear, planar, random_point, single
from core.oracles.oracle import LiteralLaw, inverse
from core.oracles.properties import TOLERANCE, Loop, error_dynamics, storage_rate, structure_as_printed
from fjr_core.law import vdpbc

FAILS = 1e-4
"""Residual that a printed equation exceeds; that of the corrected one is below 1e-10."""


def printed_coupling_velocity(Pi_m_inverse: ca.DM, K: np.ndarray, M_l: ca.SX, s_l: ca.SX) -> ca.SX:
    """Return the last term of (40) as printed: Pi_m^-1 K' M_l' sigma_l."""
    return Pi_m_inverse @ K.T @ M_l.T @ M_l @ s_l


@pytest.fixture(params=["right", "printed"])
def coupling(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Build the laws of the test with the coupling of (40) corrected or as printed."""
    if request.param == "printed":
        monkeypatch.setattr(vdpbc, "coupling_velocity", printed_coupling_velocity)
    return request.param


def fresh_loop(arm: Arm, gains: GainSet) -> Loop:
    """Return a loop with a newly built law, so that the monkeypatch applies."""
    return Loop(arm, gains, fjr.TrackingLaw(arm.robot, gains.gains))


CASES = [(single(31.0), linear(1)), (single(3.1), linear(1)), (planar("31", 31.0), linear(2))]
CASES += [(planar("full", **FULL), full())]
cases = pytest.mark.parametrize(("arm", "gains"), CASES, ids=["single-31", "single-3.1", "planar-31", "planar-full"])


@cases
@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_exact_rate_of_the_storage_detects_the_printed_coupling(
    arm: Arm, gains: GainSet, same: bool, coupling: str
) -> None:
    """Repeat the test of tests/core/law/test_law.py for (40), with x_v = x and x_v != x."""
    residual = storage_rate(fresh_loop(arm, gains), random_point(arm, 0, same))
    assert residual <= TOLERANCE if coupling == "right" else residual > FAILS


def along(loop: Loop, run: fjr.Trajectory, i: int) -> Point:
    """Return the i-th instant of a closed-loop run."""
    x, jets = run.x[i], run.jets[i]
    return Point(x, x, jets, np.vstack([jets[1:], -jets[3:4]]), np.zeros(loop.arm.n), run.u[i])


def test_slowest_decay_of_V_detects_the_printed_coupling_but_convergence_does_not(coupling: str) -> None:
    """dV/(2V) stays below -beta = -10 with the corrected (40) and exceeds it with the printed one; both converge.

    The values are suprema on a fine grid; a grid of 10 ms gives -10.02 and -10.09.
    """
    arm, gains = single(31.0), linear(1)
    loop = fresh_loop(arm, gains)
    run = fjr.simulate(loop.plant, loop.law, fjr.Sine(1.0, 1.0), arm.robot.state(0.5, 0.5, 0, 0), 1.5, inner_step=2e-4)
    assert abs(run.x[-1, 0] - run.jets[-1, 0, 0]) < 1e-8
    assert run.V[-1] < 1e-12 * run.V[0]
    instants = (along(loop, run, i) for i in range(np.searchsorted(run.t, 0.3)))
    worst = max(loop.rate_of(loop.storage, p) / (2 * loop.storage(p.x_v, p.x, p.jets)) for p in instants)
    assert worst == pytest.approx({"right": -10.003, "printed": -9.535}[coupling], abs=0.002)


PRINTED = {
    "coupling": "q_tilde_m",
    "phi_m": "q_tilde_m",
    "gravity": "sigma_l",
    "q_md": "sigma_l",
    "spring": "sigma_m",
    "B_m": "sigma_m",
}
"""Misprints, and the error equation that each one breaks for x_v != x."""


@pytest.mark.parametrize("error", PRINTED)
def test_each_misprint_breaks_its_error_equation(error: str) -> None:
    """Equations (33), (39), (40), (42) are evaluated as printed, with the correct plant and virtual system."""
    arm, gains = planar("full", **FULL), full()
    p = random_point(arm, 2)
    residuals = error_dynamics(Loop(arm, gains, LiteralLaw(arm, gains, printed=(error,))), p)
    assert {name for name, value in residuals.items() if value > TOLERANCE} == {PRINTED[error]}, residuals
    assert residuals[PRINTED[error]] > FAILS


@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_damping_of_44_as_printed_is_symmetric_for_one_joint_only(same: bool) -> None:
    """R_v with E_l is not symmetric for n = 2; the correct split in stability/test_contraction.py has S_H in J_v."""
    one, two = (single(31.0), linear(1)), (planar("31", 31.0), linear(2))
    for (arm, gains), is_symmetric in ((one, True), (two, False)):
        _, R_v = structure_as_printed(arm, gains, random_point(arm, 4, same), arm.K @ inverse(gains.Pi_m))
        asymmetry = np.max(np.abs(R_v - R_v.T)) / np.max(np.abs(R_v))
        assert asymmetry == 0 if is_symmetric else asymmetry > FAILS


@pytest.mark.parametrize(("k", "t", "share"), [(31.0, 1.329, 2.9e-12), (3.1, 1.493, 1.08e-13)])
def test_hold_of_1_ms_lets_V_exceed_its_bound(k: float, t: float, share: float) -> None:
    """V exceeds V(0) exp(-2 beta t) from t [s] on, at V = share V(0); the run tracks sin t from rest at 0.5 rad."""
    robot = single(k).robot
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    start = robot.state(0.5, 0.5, 0, 0)
    run = fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), start, 1.6, sample_period=1e-3)
    relative = run.V / run.V[0]
    first = np.argmax(relative > np.exp(-2 * law.rate().beta * run.t))
    assert run.t[first] == pytest.approx(t, abs=5e-3)
    assert relative[first] == pytest.approx(share, rel=0.1)


@pytest.mark.parametrize("error", ["gravity", "q_md", "spring"])
def test_misprints_of_measured_for_virtual_do_not_change_the_effort_on_the_diagonal(error: str) -> None:

    arm, gains = planar("31", 31.0), linear(2)
    p = random_point(arm, 3, same=True)
    printed = LiteralLaw(arm, gains, printed=(error,)).effort(p.x, p.x, p.jets)
    right = fjr.TrackingLaw(arm.robot, gains.gains).effort(p.x, p.x, p.jets)
    assert printed == pytest.approx(right, rel=1e-10)


def test_right_column_of_table_1_lists_the_motor_gains() -> None:
    """Lambda_m = 15, K_md = 0.3 and Pi_m = 4 Lambda_m = 60 are printed with subscript l."""
    values = {"Lambda_l": 10, "Pi_l": 20, "K_ld": 0.6, "Lambda_m": 15, "Pi_m": 60, "K_md": 0.3}
    values.update(Gamma_l=0, Gamma_m=0)
    assert {name: getattr(fjr.PAPER_GAINS, name) for name in values} == values
