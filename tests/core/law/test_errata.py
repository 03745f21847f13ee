# SPDX-License-Identifier: Apache-2.0
"""The equations as printed fail the tests that the corrected ones pass (docs/paper_map.md).

Eq. (49) is tested in stability/test_contraction.py, next to the corrected one.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import fjr_core as fjr
from core.oracles.cases import FULL, Arm, GainSet, full, linear, planar, random_point, single
from core.oracles.oracle import LiteralLaw, inverse
from core.oracles.properties import TOLERANCE, Loop, error_dynamics, storage_rate, structure_as_printed

FAILS = 1e-4
"""Residual that a printed equation exceeds; that of the corrected one is below 1e-10."""


CASES = [(single(31.0), linear(1)), (planar("full", **FULL), full())]


@pytest.mark.parametrize(("arm", "gains"), CASES, ids=["single-31", "planar-full"])
@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_exact_rate_of_the_storage_detects_the_printed_coupling(arm: Arm, gains: GainSet, same: bool) -> None:
    """The law of tests/core/law/test_law.py, with (40) as printed and with x_v = x and x_v != x."""
    law = LiteralLaw(arm, gains, printed=("coupling",))
    assert storage_rate(Loop(arm, gains, law), random_point(arm, 0, same)) > FAILS


@pytest.mark.parametrize(("printed", "slowest"), [((), -10.003), (("coupling",), -9.535)], ids=["right", "printed"])
def test_slowest_decay_of_V_detects_the_printed_coupling_but_convergence_does_not(
    printed: tuple[str, ...], slowest: float
) -> None:
    """dV/(2V) stays below -beta = -10 with the corrected (40) and exceeds it with the printed one; both converge.

    One joint with linear phi has errors e(t) = exp(A t) e(0) and V = e' W e / 2 with constant A and W. The values are
    suprema before 0.3 s on a fine grid; a grid of 10 ms gives -10.02 and -10.09.
    """
    arm, gains = single(31.0), linear(1)
    M, m, k, Pi_m = 0.031, 0.004, 31.0, 60.0
    A = np.array([
        [-10, 0, 1 / M, 0],
        [0, -15, -k / Pi_m * (M if printed else 1 / M), 1 / m],
        [-20, k, -(0.2 + 0.6) / M, 0],
        [0, -Pi_m, 0, -(0.007 + 0.3) / m],
    ])  # fmt: skip
    W, x = np.diag([20, Pi_m, 1 / M, 1 / m]), arm.robot.state(0.5, 0.5, 0, 0)
    start = Loop(arm, gains, LiteralLaw(arm, gains, printed)).errors(x, x, fjr.Sine(1.0, 1.0).jets(0.0))
    errors = np.array([expm(A * t) @ start for t in np.arange(0, 0.3, 2e-4)])
    V, dV = (np.einsum("ki,ij,kj->k", errors, form, errors) for form in (W / 2, W @ A))
    assert np.max(dV / (2 * V)) == pytest.approx(slowest, abs=0.002)
    assert np.max(np.abs(expm(A * 1.5) @ start)) < 1e-6


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
