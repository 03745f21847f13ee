# SPDX-License-Identifier: Apache-2.0
"""Springs that harden: their curve and its inverse, and the inverse dynamics and linearisation of a robot with them.

Identities of plant and law on such robots are in test_port_hamiltonian.py, test_virtual_system.py and law/test_law.py.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq

import fjr_core as fjr
from core.oracles.cases import HARD, Arm, Array, hardened, linear, planar
from core.oracles.oracle import jacobian
from core.oracles.properties import loop_of, residual
from fjr_core.config.scenario import parse_scenario
from fjr_core.law.linearized import equilibria_at, error_dynamics, error_matrices, feedback, plant_matrices
from fjr_core.model import springs
from fjr_core.monitoring.certificate import Certificate
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_design.batch.parametric_robot import ParametricPlant, layout

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


@arms
def test_secant_joins_two_points_and_the_tangent_one(arm: Arm) -> None:
    rng = np.random.default_rng(3)
    for a, b in rng.uniform(-0.1, 0.1, (20, 2, arm.n)):
        S = ca.DM(springs.secant(arm.robot, ca.DM(a), ca.DM(b))).full()
        assert residual(arm.spring(a) - arm.spring(b), S @ (a - b)) <= 1e-14
        tangent = np.linalg.inv(ca.DM(springs.compliance(arm.robot, ca.DM(a))).full())
        given = zip(np.diag(arm.K), arm.cubic, a, strict=True)
        slope = [mpmath.diff(lambda z, K=K, k=k: K * z + k * z**3, z) for K, k, z in given]
        assert np.diag(tangent) == pytest.approx(np.array(slope, dtype=float), rel=EXACT)
        same = ca.DM(springs.secant(arm.robot, ca.DM(a), ca.DM(a))).full()
        assert same == pytest.approx(tangent, rel=1e-14)


@arms
def test_inverse_dynamics_keep_the_links_on_their_motion(arm: Arm) -> None:
    """Motor motion and torque satisfy both equations, with motor derivatives by differences along the motion."""
    rng = np.random.default_rng(7)
    jets = rng.uniform(-1, 1, (5, arm.n))
    motion = inverse_dynamics(arm.robot)

    def at(t: float, kind: type = float) -> list[Array]:
        factor = [[t**k / float(mpmath.factorial(k)) for k in range(5)]]
        moved = [sum(f * jets[i + k] for k, f in enumerate(factor[0][: 5 - i])) for i in range(5)]
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


def test_a_factor_on_the_stiffness_of_a_drawn_robot_scales_the_curve() -> None:
    n, drawn = 2, ParametricPlant(MIXED, full=False).torque("torque")
    parts = layout(n)
    values = {name: np.ones(size) for name, size in parts.sizes.items()} | {"stiffness": np.sqrt([1.2, 0.7])}
    parameters = np.concatenate([values[name] for name in parts.sizes])
    q = np.array([0.1, -0.2, 0.11, -0.17])
    expected = np.array([1.2, 0.7]) * (np.diag(MIXED.K) * (q[2:] - q[:2]) + MIXED.cubic * (q[2:] - q[:2]) ** 3)
    assert scalar(drawn(q, parameters)) == pytest.approx(expected, rel=1e-14)


def test_straight_springs_keep_their_expressions() -> None:
    """Zeros are no curve: fingerprint, plant, law, certificate and inverse dynamics are those of the robot without."""
    straight = planar("31", 31.0).robot
    zeros = replace(straight, cubic=np.zeros(2))
    assert zeros.cubic is None
    assert zeros.fingerprint() == straight.fingerprint()
    assert hardened(planar("31", 31.0), 0.1).robot.fingerprint() != straight.fingerprint()

    def functions(robot: fjr.Robot) -> list[ca.Function]:
        law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
        of_law = law.measured_expression, Certificate(law).function
        return [*of_law, fjr.Plant(robot).dynamics, inverse_dynamics(robot)]

    for one, other in zip(functions(straight), functions(zeros), strict=True):
        assert one.serialize() == other.serialize()
        assert one.n_instructions() == other.n_instructions()


SCENARIO = """
/**:
  ros__parameters:
    joints: [a, b]
    robot: {{model: planar_two_link, cubic_stiffness: {cubic}}}
    {more}
"""


def test_a_scenario_gives_plant_and_law_the_curve() -> None:
    scenario = parse_scenario("hard", SCENARIO.format(cubic="[1.0e5, 0.0]", more=""))
    assert scenario.robot.cubic == pytest.approx([1e5, 0.0])
    assert scenario.plant.robot.cubic == pytest.approx([1e5, 0.0])
    assert scenario.plant_is_the_model
    assert "cubic" in repr(scenario.robot)
    assert parse_scenario("straight", SCENARIO.format(cubic="[0.0, 0.0]", more="")).robot.cubic is None


@pytest.mark.parametrize(
    ("cubic", "more", "sentence"),
    [
        ("[-1.0, 0.0]", "", "'robot.cubic_stiffness' holds -1.0 N m/rad^3; expected at least 0.0"),
        ("[1.0]", "", "'robot.cubic_stiffness' has 1"),
        ("[1.0, 1.0]", "robot.joint_stiffness: [40.0, 1.0, 1.0, 25.0]", "'robot.cubic_stiffness': cubic is not 0 with"),
        (
            "[1.0, 1.0]",
            "measurement: {velocity: observer, motor: torque}",
            "'measurement.motor' is 'torque' with a robot.cubic_stiffness; expected 'position', or straight springs",
        ),
    ],
)
def test_what_has_no_inverse_is_refused(cubic: str, more: str, sentence: str) -> None:
    with pytest.raises(fjr.ParameterError) as refused:
        _ = parse_scenario("hard", SCENARIO.format(cubic=cubic, more=more))
    assert sentence in str(refused.value)
