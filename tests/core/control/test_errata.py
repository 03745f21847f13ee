# SPDX-License-Identifier: Apache-2.0
"""The equations as printed fail the tests that the right ones pass (docs/errata.md).

(49) is in stability/test_contraction.py, next to the right one.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
import fjr_core.control.vdpbc.motor_stage as motor
from core.oracles.cases import FULL, Arm, GainSet, Point, full, linear, planar, random_point, single
from core.oracles.oracle import LiteralLaw, inverse
from core.oracles.properties import TOLERANCE, Loop, error_dynamics, storage_rate, structure_as_printed

FAILS = 1e-4
"""A printed equation misses by more than this, where the right one stays below 1e-10."""


def printed_coupling_velocity(Pi_m_inverse: ca.DM, K: np.ndarray, M_l: ca.SX, s_l: ca.SX) -> ca.SX:
    """The last term of (40) as printed: Pi_m^-1 K' M_l' sigma_l."""
    return Pi_m_inverse @ K.T @ M_l.T @ M_l @ s_l


@pytest.fixture(params=["right", "printed"])
def coupling(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Laws built in the test have the coupling of (40) right, or as printed."""
    if request.param == "printed":
        monkeypatch.setattr(motor, "coupling_velocity", printed_coupling_velocity)
    return request.param


def fresh_loop(arm: Arm, gains: GainSet) -> Loop:
    """With a law that is built now, not one that was built before the patch."""
    return Loop(arm, gains, fjr.TrackingLaw(arm.robot, gains.gains))


CASES = [(single(31.0), linear(1)), (single(3.1), linear(1)), (planar("31", 31.0), linear(2))]
CASES += [(planar("full", **FULL), full())]
cases = pytest.mark.parametrize(("arm", "gains"), CASES, ids=["single-31", "single-3.1", "planar-31", "planar-full"])


@cases
@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_exact_rate_of_the_storage_tells_the_printed_coupling(
    arm: Arm, gains: GainSet, same: bool, coupling: str
) -> None:
    """(40): the same test as in control/test_law.py; x_v = x or not makes no difference."""
    residual = storage_rate(fresh_loop(arm, gains), random_point(arm, 0, same))
    assert residual <= TOLERANCE if coupling == "right" else residual > FAILS


@cases
def test_only_the_motor_equation_reveals_the_printed_coupling(arm: Arm, gains: GainSet, coupling: str) -> None:
    residuals = error_dynamics(fresh_loop(arm, gains), random_point(arm, 1))
    q_tilde_m = residuals.pop("q_tilde_m")
    assert max(residuals.values()) <= TOLERANCE
    assert q_tilde_m <= TOLERANCE if coupling == "right" else q_tilde_m > FAILS


def along(loop: Loop, run: fjr.Trajectory, i: int) -> Point:
    """The i-th instant of a closed-loop run."""
    x, jets = run.x[i], run.jets[i]
    return Point(x, x, jets, np.vstack([jets[1:], -jets[3:4]]), np.zeros(loop.arm.n), run.u[i])


def test_worst_decay_along_the_papers_trajectory_tells_but_convergence_does_not(coupling: str) -> None:
    """dV/(2V) stays below -beta = -10 with the right (40) and breaks it with the print; both converge.

    The figures are the suprema over a fine grid; a coarse one finds milder ones (10 ms: -10.02 and -10.09).
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
"""Errors of the print, and the error equation that each one breaks when x_v != x."""


@pytest.mark.parametrize("error", PRINTED)
def test_each_printed_equation_breaks_its_error_equation(error: str) -> None:
    """(33), (39), (40), (42) as printed, literally, in the loop with the real plant and virtual system."""
    arm, gains = planar("full", **FULL), full()
    p = random_point(arm, 2)
    residuals = error_dynamics(Loop(arm, gains, LiteralLaw(arm, gains, printed=(error,))), p)
    assert {name for name, value in residuals.items() if value > TOLERANCE} == {PRINTED[error]}, residuals
    assert residuals[PRINTED[error]] > FAILS


@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_damping_of_44_as_printed_is_symmetric_for_one_joint_only(same: bool) -> None:
    """R_v with E_l is not symmetric for n = 2; stability/test_contraction.py has the right split, S_H in J_v."""
    one, two = (single(31.0), linear(1)), (planar("31", 31.0), linear(2))
    for (arm, gains), is_symmetric in ((one, True), (two, False)):
        _, R_v = structure_as_printed(arm, gains, random_point(arm, 4, same), arm.K @ inverse(gains.Pi_m))
        asymmetry = np.max(np.abs(R_v - R_v.T)) / np.max(np.abs(R_v))
        assert asymmetry == 0 if is_symmetric else asymmetry > FAILS


@pytest.mark.parametrize(("k", "t", "share"), [(31.0, 1.329, 2.9e-12), (3.1, 1.493, 1.08e-13)])
def test_a_hold_of_one_millisecond_takes_V_beyond_its_bound(k: float, t: float, share: float) -> None:
    """From t [s] on V > V(0) exp(-2 beta t), at V = share V(0): sin t from 0.5 rad at rest."""
    robot = single(k).robot
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    start = robot.state(0.5, 0.5, 0, 0)
    run = fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), start, 1.6, sample_period=1e-3)
    relative = run.V / run.V[0]
    first = np.argmax(relative > np.exp(-2 * law.rate().beta * run.t))
    assert run.t[first] == pytest.approx(t, abs=5e-3)
    assert relative[first] == pytest.approx(share, rel=0.1)


@pytest.mark.parametrize("error", ["gravity", "q_md", "spring"])
def test_measured_for_virtual_cannot_be_told_on_the_diagonal(error: str) -> None:
    """At x_v = x these give the same effort: the controller u(x, x, t) does not feel them."""
    arm, gains = planar("31", 31.0), linear(2)
    p = random_point(arm, 3, same=True)
    printed = LiteralLaw(arm, gains, printed=(error,)).effort(p.x, p.x, p.jets)
    right = fjr.TrackingLaw(arm.robot, gains.gains).effort(p.x, p.x, p.jets)
    assert printed == pytest.approx(right, rel=1e-10)


def test_right_column_of_table_1_is_the_motors() -> None:
    """Lambda_m = 15, K_md = 0.3, Pi_m = 4 Lambda_m = 60; printed with subscript l."""
    values = {"Lambda_l": 10, "Pi_l": 20, "K_ld": 0.6, "Lambda_m": 15, "Pi_m": 60, "K_md": 0.3}
    values.update(Gamma_l=0, Gamma_m=0)
    assert {name: getattr(fjr.PAPER_GAINS, name) for name in values} == values
