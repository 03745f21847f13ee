# SPDX-License-Identifier: Apache-2.0
"""Springs that harden: their curve and its inverse, and the inverse dynamics and linearisation of a robot with them.

Identities of plant and law on such robots are in test_port_hamiltonian.py, test_virtual_system.py and law/test_law.py.
"""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import mpmath
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

import fjr_core as fjr
from core.oracles.cases import HARD, TORSION, Arm, Array, hardened, linear, planar, random_point
from core.oracles.oracle import STEP, LiteralLaw, exact, jacobian
from core.oracles.properties import loop_of, residual, storage_terms
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.law.linearized import equilibria_at, error_dynamics, error_matrices, feedback, plant_matrices
from fjr_core.model import springs
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_design.batch.parametric_robot import ParametricPlant, layout
from fuzzing import refused

arms = pytest.mark.parametrize("arm", HARD, ids=[arm.name for arm in HARD])
MIXED = replace(fjr.planar_two_link(), cubic=[0.0, 1e5])
EXACT = 1e-12


def scalar(value: object) -> Array:
    return ca.DM(value).full().ravel()


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 1e6])
def test_inverse_is_the_root_of_the_curve(size: float) -> None:
    """Bisection finds it to rounding, from torques of straight springs to those of the cubic part alone."""
    tau = size * np.array([0.7, -1.3])
    given = zip(np.diag(MIXED.K), MIXED.cubic, tau, strict=True)
    torques = [lambda z, K=K, k=k, t=t: K * z + k * z**3 - t for K, k, t in given]
    roots = [brentq(torque, -size, size, xtol=1e-300, rtol=1e-15) for torque in torques]
    zeta = MIXED.deflection(tau)
    assert zeta == pytest.approx(roots, rel=4e-15)
    assert scalar(springs.torque(MIXED, ca.DM(zeta))) == pytest.approx(tau, rel=2e-15)


@pytest.mark.parametrize("k", [5e-324, 1e-310, 1e-9, 1e300])
def test_inverse_is_the_root_of_any_curve(k: float) -> None:
    zeta = float(springs.root(1000.0, k, 5.0, np))
    with mpmath.workdps(400):
        torque = 1000 * mpmath.mpf(zeta) + mpmath.mpf(k) * mpmath.mpf(zeta) ** 3
    assert float(torque) == pytest.approx(5.0, rel=EXACT)


tables = pytest.mark.parametrize("arm", TORSION, ids=[arm.name for arm in TORSION])


@tables
def test_a_torsion_curve_is_the_integral_of_its_tangent(arm: Arm) -> None:
    """Torque, energy, tangent and inverse agree with the oracle, near zero, at all knots and beyond the last one."""
    assert arm.torsion is not None
    for j, of in enumerate(arm.robot.curves):
        knots = np.array(arm.torsion.knots[j])
        for zeta in np.outer([1.0, -1.0], [1e-9, *knots[1:], *(knots + 0.013), 5.0]).ravel():
            torque = arm.torsion.torque(j, zeta)
            at = ca.DM(zeta)
            assert float(of.phi(at)) == pytest.approx(torque, rel=1e-14)
            assert float(of.stored(at)) == pytest.approx(arm.torsion.energy(j, zeta), rel=1e-14)
            assert float(of.tangent(at)) == pytest.approx(arm.torsion.tangent(j, zeta), rel=1e-13)
            assert float(of.inverse(ca.DM(torque))) == pytest.approx(zeta, rel=1e-14)
    zeta = np.random.default_rng(0).uniform(-0.4, 0.4, (50, arm.n))
    assert springs.torques(arm.robot, zeta) == pytest.approx(np.array([arm.spring(each) for each in zeta]), rel=1e-14)
    slopes = [arm.torsion.each(arm.torsion.tangent, each) / np.diag(arm.K) for each in zeta]
    assert springs.hardening(arm.robot, zeta) == pytest.approx(np.array(slopes), rel=1e-13)


def test_a_torsion_curve_meets_its_points_with_the_slopes_of_scipy_and_rises() -> None:
    """Evenly spaced points have the slopes of SciPy's monotone cubic interpolation, which begins with the slope K."""
    z, t = 0.01 * np.arange(1.0, 8.0), np.array([1.0, 2.5, 3.0, 7.0, 7.1, 7.2, 12.0])
    of = springs.torsion_curve(100.0, z, t)
    odd = PchipInterpolator(np.concatenate([-z[::-1], [0.0], z]), np.concatenate([-t[::-1], [0.0], t]))
    assert [float(of.phi(ca.DM(each))) for each in z] == pytest.approx(t, rel=1e-15)
    inner = np.append(0.0, z[:-1])
    assert of.tangent(ca.DM(inner)).full().ravel() == pytest.approx(odd(inner, 1), rel=1e-12)
    fine = of.phi(ca.DM(np.linspace(-0.1, 0.1, 4001))).full().ravel()
    assert np.all(np.diff(fine) > 0)
    rising = np.random.default_rng(1).uniform(0.01, 1.0, (200, 2, 5)).cumsum(axis=2)
    assert min(springs.torsion_curve(points[1, 0] / points[0, 0], *points).stiffness.min() for points in rising) > 0


@tables
@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_the_law_on_torsion_curves_and_its_storage_rate_are_exact_to_1e_12(arm: Arm, same: bool) -> None:
    """The oracle evaluates (30)-(43) in 80 digits, and dV/dt by differences along the flow under the law's effort."""
    gains, p = linear(arm.n), random_point(arm, 0, same)
    law, literal = loop_of(arm, gains).law, LiteralLaw(arm, gains)
    e, wanted = (each.evaluate(p.x_v, p.x, p.jets, p.omega) for each in (law, literal))
    for name in ("u", "q_md", "q_tilde_m", "sigma_m", "V"):
        assert residual(np.asarray(getattr(e, name)), np.asarray(getattr(wanted, name))) <= EXACT, name
    of, z, plant = wanted.law, wanted.z, wanted.law.plant
    x_v, x, _ = of.states(z)
    dx = plant.derivative(x, exact(e.u if same else p.u))
    dz = np.concatenate([plant.virtual(x_v, x, exact(e.u)), dx, [mpmath.mpf(1)]])
    dV = float((of.V(z + STEP * dz) - of.V(z - STEP * dz)) / (2 * STEP))
    assert residual(np.asarray(dV), *map(np.asarray, storage_terms(loop_of(arm, gains), p))) <= EXACT
    assert e.dV == pytest.approx(dV, rel=1e-10, abs=1e-11 * e.dissipation)


@pytest.mark.parametrize("arm", [*HARD, *TORSION], ids=lambda arm: arm.name)
def test_secant_joins_two_points_and_the_tangent_one(arm: Arm) -> None:
    rng = np.random.default_rng(3)
    for a, b in rng.uniform(-0.1, 0.1, (20, 2, arm.n)):
        S = ca.DM(springs.secant(arm.robot, ca.DM(a), ca.DM(b))).full()
        assert residual(arm.spring(a) - arm.spring(b), S @ (a - b)) <= 1e-14
        tangent = np.linalg.inv(ca.DM(springs.compliance(arm.robot, ca.DM(a))).full())
        slope = np.diag(jacobian(arm.spring, a, np.full(arm.n, 1e-7)))
        assert np.diag(tangent) == pytest.approx(slope, rel=1e-6)
        same = ca.DM(springs.secant(arm.robot, ca.DM(a), ca.DM(a))).full()
        assert same == pytest.approx(tangent, rel=1e-14)


@pytest.mark.parametrize("arm", [*HARD, *TORSION], ids=lambda arm: arm.name)
def test_inverse_dynamics_keep_the_links_on_their_motion(arm: Arm) -> None:
    """Motor motion and torque satisfy both equations, with motor derivatives by differences along the motion."""
    rng = np.random.default_rng(7)
    jets = rng.uniform(-1, 1, (5, arm.n))
    motion = inverse_dynamics(arm.robot)

    def at(t: float) -> list[Array]:
        moved = [sum(t**k / math.factorial(k) * jets[i + k] for k in range(5 - i)) for i in range(5)]
        return [each.full().ravel() for each in motion(*moved)]

    tau, theta, dtheta, ddtheta, torque = at(0.0)
    h = 1e-4
    before, after = at(-h), at(h)
    assert residual(tau, arm.spring(theta - jets[0])) <= 1e-13
    assert dtheta == pytest.approx((after[1] - before[1]) / (2 * h), rel=1e-5, abs=1e-6)
    assert ddtheta == pytest.approx((after[2] - before[2]) / (2 * h), rel=1e-4, abs=1e-4)
    assert residual(torque, arm.M_m @ ddtheta, arm.D_m @ dtheta, tau) <= 1e-13


@arms
def test_linearisation_has_the_tangents_under_the_weight(arm: Arm) -> None:
    """Plant and law agree with differences about an equilibrium, where springs carry the weight of the links."""
    arm = hardened(replace(arm, robot=replace(arm.robot, cubic=None)), 0.02)
    gains, q_l, n = linear(arm.n), np.linspace(0.9, -0.4, arm.n)[None], arm.n
    law, points = loop_of(arm, gains).law, equilibria_at(arm.robot, q_l)
    x, u, jets = points.x[0], points.u[0], np.vstack([q_l, np.zeros((4, n))])
    plant = fjr.Plant(arm.robot)
    assert plant.derivative(x, u) == pytest.approx(np.zeros(4 * n), abs=1e-12)
    assert np.all(points.hardening > 1.2)
    steps = np.concatenate([np.full(2 * n, 2e-4), np.diag(points.M_l[0]) * 2e-3, np.diag(arm.M_m) * 2e-3])
    A = jacobian(lambda y: plant.derivative(y, u), x, steps)
    F = jacobian(lambda y: law.command(y, jets), x, steps)
    scale = np.outer(1 / steps, steps)
    assert A / scale == pytest.approx(plant_matrices(points)[0][0] / scale, abs=1e-6 * np.max(np.abs(A / scale)))
    closed = feedback(points, law.gains)[0]
    assert F * steps == pytest.approx(closed * steps, abs=1e-6 * np.max(np.abs(F * steps)))
    Theta, E = error_matrices(points, law.gains)[0], error_dynamics(points, law.gains)[0]
    whole = plant_matrices(points)[0][0] + plant_matrices(points)[1][0] @ closed
    assert residual(Theta @ whole, E @ Theta) <= 1e-9


@pytest.mark.parametrize("arm", [HARD[1], TORSION[1]], ids=lambda arm: arm.name)
def test_a_factor_on_the_stiffness_of_a_drawn_robot_scales_the_curve(arm: Arm) -> None:
    n, drawn, factors = 2, ParametricPlant(arm.robot, "plain").functions_as_c["plain_torque"], np.array([1.2, 0.7])
    parts = layout(n)
    values = {name: np.ones(size) for name, size in parts.sizes.items()} | {"stiffness": np.sqrt(factors)}
    parameters = np.concatenate([values[name] for name in parts.sizes])
    q = np.array([0.1, -0.2, 0.11, -0.17])
    zeta = q[2:] - q[:2]
    assert scalar(drawn(np.append(q, zeta), parameters)) == pytest.approx(factors * arm.spring(zeta), rel=1e-14)


def test_zeros_are_no_curve() -> None:
    """Fingerprint, and so every function that is cached, are those of the robot without."""
    straight = planar("31", 31.0).robot
    zeros = replace(straight, cubic=np.zeros(2), torsion=np.zeros((2, 3, 2)))
    assert (zeros.cubic, zeros.torsion, zeros.fingerprint()) == (None, None, straight.fingerprint())
    assert hardened(planar("31", 31.0), 0.1).robot.fingerprint() != straight.fingerprint()


def scenario(curve: str, more: str = "") -> Scenario:
    parameters = f"joints: [a, b], robot: {{model: planar_two_link, {curve}}}, {more}"
    return parse_scenario("hard", f"{{/**: {{ros__parameters: {{{parameters}}}}}}}")


def test_a_scenario_gives_plant_and_law_the_curve() -> None:
    hard = scenario("cubic_stiffness: [1.0e5, 0.0]")
    for robot in (hard.robot, hard.plant.robot):
        assert robot.cubic == pytest.approx([1e5, 0.0])
    assert hard.plant_is_the_model
    assert "cubic" in repr(hard.robot)
    assert scenario("cubic_stiffness: [0.0, 0.0]").robot.cubic is None
    on_table = scenario("torsion_deflection: [0.1, 0.0, 0.3, 0.0], torsion_torque: [5.0, 0.0, 20.0, 0.0]")
    assert on_table.plant.robot.torsion == pytest.approx(np.array([[[0.1, 0], [0.3, 0]], [[5, 0], [20, 0]]]))
    assert "2 points of torsion" in repr(on_table.robot)
    assert on_table.robot.deflection([20.0, 3.0]) == pytest.approx([0.3, 3.0 / on_table.robot.K[1, 1]])


TABLE = "torsion_deflection: [0.1, 0.1], torsion_torque"
FULL_K, BY_TORQUE = "joint_stiffness: [40.0, 1.0, 1.0, 25.0]", "measurement: {velocity: observer, motor: torque}"
REFUSED = [
    ("cubic_stiffness: [-1.0, 0.0]", "", "'robot.cubic_stiffness' holds -1.0 N m/rad^3; expected at least 0.0"),
    ("cubic_stiffness: [1.0]", "", "'robot.cubic_stiffness' has length 1"),
    (f"{TABLE}: [5.0, 5.0], cubic_stiffness: [1.0, 1.0]", "", "torsion is given with a cubic stiffness"),
    (f"{TABLE}: [5.0, 5.0, 6.0, 6.0]", "", "'robot.torsion_torque' has 2 points; expected 1"),
    (f"{TABLE}: [5.0, 0.0]", "", "torsion of joint 2 is [[0.1], [0.0]]; expected increasing positive"),
    (f"{TABLE}: [5.0, 0.1]", "", "torsion of joint 2 begins so much flatter than its K of"),
    (f"cubic_stiffness: [1.0, 1.0], {FULL_K}", "", "'robot.cubic_stiffness': cubic is not 0 with"),
    ("cubic_stiffness: [1.0, 1.0]", BY_TORQUE, "'measurement.motor' is 'torque' with a robot.cubic_stiffness; exp"),
]


@pytest.mark.parametrize(("curve", "more", "sentence"), REFUSED)
def test_what_has_no_inverse_is_refused(curve: str, more: str, sentence: str) -> None:
    refused(fjr.ParameterError, lambda: scenario(curve, more), sentence)


def test_more_points_than_the_step_has_room_for_are_refused() -> None:
    nine = np.ones((2, 9, 1)).cumsum(axis=1)
    refused(fjr.RobotError, lambda: springs.checked_torsion(nine, np.eye(1)), "m of 1 to 8")
    np.testing.assert_array_equal(springs.checked_torsion(nine[:, :8], np.eye(1)), nine[:, :8])
