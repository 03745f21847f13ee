# SPDX-License-Identifier: Apache-2.0
"""Non-ideal plant: exact power balance with each imperfection, payloads equal to heavier links, exact actuators."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import fjr_core as fjr
from core.oracles.cases import ARMS, PLANAR, Arm, PlanarTwoLink, SingleLink, random_point
from core.oracles.chains import PinocchioLinks, random_urdf
from core.oracles.oracle import jacobian, stencil
from core.oracles.properties import TOLERANCE, residual
from fjr_core.model.rigid_arm import closed_form
from fjr_core.numerics.symbolic import NumericFunction, symbols
from fjr_core.simulation.imperfections import NAMES, SWITCHES, Imperfections, friction_rate, largest_load, stuck_rate
from fjr_core.simulation.nonideal_plant import NonidealPlant

Array = NDArray[Any]
DT = 2.5e-4
arms = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
seeds = pytest.mark.parametrize("seed", range(2))


def plant_of(robot: fjr.Robot, **options: Any) -> NonidealPlant:
    return NonidealPlant(fjr.Plant(robot, **options))


def deflection(x: Array) -> Array:
    """Return the deflections (n,) of the springs at x (4n,)."""
    return np.diff(x[: len(x) // 2].reshape(2, -1), axis=0)[0]


def started(x: Array) -> Array:
    """Return the state (6n,) at x (4n,) without output of the actuators and without torque of the Maxwell elements."""
    return np.concatenate([x, np.zeros(len(x) // 4), deflection(x)])


def derivative(
    plant: NonidealPlant, x: Array, applied: Any, external: Any, parameters: Array, sliders: Array | None = None
) -> Array:
    """dx/dt (4n,) at x (4n,) under actuator outputs and external torques (n,) [N m] on the links.

    sliders (n,): None where the Maxwell elements carry no torque.
    """
    at = deflection(x) if sliders is None else sliders
    return NumericFunction(plant.dynamics)(x, np.concatenate([applied, external, at, parameters]))[0]


def energy(plant: NonidealPlant, x: Array, parameters: Array) -> float:
    """Return the energy [J] at x (4n,) of the robot with its payload and cubic springs."""
    s = symbols(x=len(x), parameters=len(parameters))
    H = plant.robot_of(plant.named(s["parameters"])).hamiltonian_expression(s["x"])
    return float(ca.Function("H", list(s.values()), [H])(x, parameters))


def everything(n: int) -> Imperfections:
    """Return all imperfections at once, with different values for every joint."""
    k = 1 + 0.3 * np.arange(n)
    return Imperfections(
        n,
        coulomb_l=0.2 * k,
        static_l=0.35 * k,
        stribeck_l=0.4 / k,
        coulomb_m=0.1 * k,
        static_m=0.15 * k * (np.arange(n) % 2),  # without effect where it is below the Coulomb level
        stribeck_m=0.3 * k,
        load_l=0.04 * k,
        load_m=0.05 * k,
        smoothing=0.05 * k,
        cubic=40 * k,
        hysteresis=0.6 * k,
        slip=0.3 / k,
        ripple=0.07 * k,
        ripple_periods=7 * k,
        ripple_phase=0.4 * k,
        effort_limit=3 * k,
        lag=0.004 * k,
        payload_mass=0.6,
        payload_position=(0.2, -0.1, 0.05),
    )


def friction(v: Array, coulomb: Array, static: Array, stribeck: Array, smoothing: Array, of_load: Array) -> Array:
    """Return the friction torque of the hand-written model."""
    level = coulomb + np.maximum(static - coulomb, 0) * np.exp(-((v / stribeck) ** 2)) + of_load
    return level * np.tanh(v / smoothing)


def test_each_switch_and_no_other_parameter_enables_the_nonideal_plant() -> None:
    assert Imperfections(3).off
    for name in NAMES:
        assert Imperfections(2, **{name: 0.5}).off == (name not in (*SWITCHES, "effort_limit"))


@pytest.mark.parametrize("integrator", ["rk4", "implicit_midpoint"])
@arms
def test_step_without_imperfections_is_that_of_the_plant(arm: Arm, integrator: str) -> None:
    p, n = random_point(arm, 1), arm.n
    plant = fjr.Plant(arm.robot, integrator)
    seen = NonidealPlant(plant).step(started(p.x), p.u, np.zeros(n), Imperfections(n).vector, DT)
    np.testing.assert_allclose(seen[: 4 * n], plant.step(p.x, p.u, DT), rtol=1e-14, atol=1e-16)
    assert np.array_equal(seen[4 * n : 5 * n], p.u)


@arms
@seeds
def test_power_balance_with_all_imperfections(arm: Arm, seed: int) -> None:
    """dH/dt = power of actuators, external torques, ripple and Maxwell elements - viscous damping - friction.

    With one joint, each power is a torque: this is the hand-written model of each of them.
    """
    p, n, i = random_point(arm, seed), arm.n, everything(arm.n)
    plant, rng = plant_of(arm.robot), np.random.default_rng(seed)
    push, sliders = rng.uniform(-2, 2, n), deflection(p.x) + rng.uniform(-0.5, 0.5, n)
    dx = derivative(plant, p.x, p.u, push, i.vector, sliders)
    dq_l, dq_m = dx[:n], dx[n : 2 * n]
    dH = stencil(lambda s: energy(plant, p.x + s * dx, i.vector), 2e-3 / max(1, float(np.max(np.abs(dx)))))
    ripple = i.ripple * np.sin(i.ripple_periods * p.x[n : 2 * n] + i.ripple_phase)
    h = i.hysteresis * np.clip((deflection(p.x) - sliders) / i.slip, -1, 1)
    load = np.abs(arm.K @ deflection(p.x) + i.cubic * deflection(p.x) ** 3 + h)
    F_l = friction(dq_l, i.coulomb_l, i.static_l, i.stribeck_l, i.smoothing, i.load_l * load)
    F_m = friction(dq_m, i.coulomb_m, i.static_m, i.stribeck_m, i.smoothing, i.load_m * load)
    supplied = (dq_m @ arm.B_m @ p.u, dq_l @ push, dq_m @ ripple, dq_l @ h, -dq_m @ h)
    lost = (-dq_l @ arm.D_l @ dq_l, -dq_m @ arm.D_m @ dq_m, -dq_l @ F_l, -dq_m @ F_m)
    assert residual(dH, *supplied, *lost) <= TOLERANCE
    assert max(lost) <= 0


def test_friction_rate_is_the_slope_at_rest() -> None:
    """The rate is the most negative eigenvalue of the part of d(dp)/dp that is due to friction."""
    robot, i = ARMS[-1].robot, Imperfections(2, coulomb_l=[0.2, 0.1], static_m=[0.1, 0.3])
    q_l, plant = np.array([0.4, -0.9]), plant_of(ARMS[-1].robot)

    def of_friction(x: Array) -> Array:
        dx = [derivative(plant, x, [0, 0], [0, 0], of.vector) for of in (i, Imperfections(2))]
        return dx[0] - dx[1]

    slopes = jacobian(of_friction, robot.state(q_l, q_l, [0, 0], [0, 0]), np.full(8, 1e-6))
    fastest = -np.min(np.linalg.eigvals(slopes[4:, 4:]).real)
    assert friction_rate(i, robot.M_l(q_l), robot.M_m) == pytest.approx(fastest, rel=1e-5)
    loaded, same = Imperfections(2, load_l=[0.1, 0.3]), Imperfections(2, coulomb_l=[0.2, 0.3])
    rates = [friction_rate(each, robot.M_l(q_l), robot.M_m, [2.0, 1.0]) for each in (loaded, same)]
    assert rates[0] == pytest.approx(rates[1], rel=1e-15)


def test_the_largest_load_is_the_effort_limit_or_the_weight_of_a_link_held_out() -> None:
    robot = fjr.planar_two_link()
    held_out = np.abs(robot.grad_P_l([np.pi / 2, 0.0]))
    assert largest_load(robot, np.zeros(2)) == pytest.approx(held_out, rel=1e-12)
    assert largest_load(robot, np.zeros(2), [3.0, np.inf]) == pytest.approx([3.0, held_out[1]], rel=1e-12)
    limited = replace(robot, limits=fjr.JointLimits([-1, -1], [1, 1], [1, 1], [5.0, 0.1]))
    assert largest_load(limited, np.zeros(2), [3.0, np.inf]).tolist() == [3.0, 0.1]


def test_the_largest_load_is_the_largest_torque_of_all_efforts_within_their_limits() -> None:
    for B_m in ([[0.5, 0.0], [0.0, -2.0]], [[0.5, 0.5], [0.5, -0.5]]):
        corners = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) * [8.0, 6.0]
        most = (corners @ np.transpose(B_m)).max(axis=0)
        assert largest_load(fjr.planar_two_link(input_gain=B_m), np.zeros(2), [8.0, 6.0]) == pytest.approx(most)


# Springs.


@arms
def test_cubic_springs_store_a_quarter_of_the_fourth_power(arm: Arm) -> None:
    x, cubic, plant = random_point(arm, 2).x, 50.0 + 10 * np.arange(arm.n), plant_of(arm.robot)
    n, zeta = arm.n, deflection(x)
    energies = [energy(plant, x, Imperfections(n, cubic=k).vector) for k in (cubic, np.zeros(n))]
    assert energies[0] - energies[1] == pytest.approx(np.sum(cubic * zeta**4) / 4, rel=1e-9)
    _, spring = plant.measure(started(x), Imperfections(n, cubic=cubic).vector)
    np.testing.assert_allclose(spring, arm.K @ zeta + cubic * zeta**3, rtol=1e-13)


# Hysteresis.


class Rheometer:
    """The joint torque of a single link without stiffness to speak of, along prescribed deflections of its spring."""

    def __init__(self, torque: float, slip: float) -> None:
        robot = fjr.single_link(stiffness=1e-12)
        self.plant, self.i = plant_of(robot), Imperfections(1, hysteresis=torque, slip=slip).vector
        self.state = np.zeros(6)

    def __call__(self, zeta: Array) -> Array:
        """Return the torque (k,) at the deflections (k,), one after the other."""
        return np.array([self._moved(each) for each in zeta])

    def _moved(self, zeta: float) -> float:
        self.state[1] = zeta
        self.state = self.plant.step(self.state, [0], [0], self.i, 0.0)
        return float(self.plant.measure(self.state, self.i)[1][0])


def test_maxwell_element_slips_at_its_torque_and_sticks_after_every_reversal() -> None:
    """Branches of a full loop are two slip torques apart; a reversal sticks along 2 slip."""
    h, slip, A = 0.4, 0.01, 0.05
    of = Rheometer(h, slip)
    up = np.linspace(0, A, 51)
    np.testing.assert_allclose(of(up), h * np.minimum(up / slip, 1), rtol=1e-9)
    down = np.linspace(A, -A, 101)
    np.testing.assert_allclose(of(down), h * np.maximum(1 - (A - down) / slip, -1), atol=1e-9)
    assert of(-down)[50] - of(down)[50] == pytest.approx(2 * h, rel=1e-9)
    within = 0.4 * slip * np.sin(np.linspace(0, 9, 60))  # below the slip there is no loop
    np.testing.assert_allclose(Rheometer(h, slip)(within), h / slip * within, atol=1e-9)


def test_no_closed_cycle_yields_work() -> None:
    """A path from rest takes the energy stored at its end and the work of the slider, which never decreases."""
    h, slip, rng = 0.7, 0.02, np.random.default_rng(0)
    corners = np.r_[0.0, rng.uniform(-0.06, 0.06, 30), 0.0]
    zeta = np.concatenate([np.linspace(a, b, 400) for a, b in zip(corners, corners[1:], strict=False)])
    torque = Rheometer(h, slip)(zeta)
    taken = np.r_[0.0, np.cumsum(np.diff(zeta) * (torque[1:] + torque[:-1]) / 2)]
    lost = taken - torque**2 * slip / (2 * h)
    assert np.all(np.diff(lost) > -1e-4 * h * slip)
    assert taken.min() >= 0
    assert lost[-1] > h * slip


def hysteretic(t: float, y: Array, h: float, slip: float) -> Array:
    """Return d(q_l, q_m, dq_l, dq_m, T)/dt of Table 1's link with a Maxwell element of torque T, in velocities."""
    q_l, q_m, v_l, v_m, T = y
    rate = v_m - v_l
    sticks = abs(T) < h or T * rate < 0
    tau = 31.0 * (q_m - q_l) + T
    link = tau - 0.2 * v_l - 0.8 * np.sin(q_l)
    return np.array(
        [v_l, v_m, link / 0.031, (0.3 * np.sin(9 * t) - tau - 0.007 * v_m) / 0.004, sticks * h / slip * rate]
    )


@pytest.mark.parametrize(("integrator", "tolerance"), [("rk4", 2e-6), ("implicit_midpoint", 1e-5)])
def test_motion_with_hysteresis_is_that_of_its_rate_equation(integrator: str, tolerance: float) -> None:
    """SciPy integrates dT/dt = (h / slip) d zeta/dt while the element sticks, with tight tolerances."""
    h, slip, dt, end = 0.2, 0.008, 2e-5, 0.2
    robot = fjr.single_link()
    plant, i = plant_of(robot, integrator=integrator), Imperfections(1, hysteresis=h, slip=slip).vector
    start = np.array([0.5, 0.53, 0.4, -0.3])
    state = started(plant.state(start[:2], start[2:], i))
    for k in range(round(end / dt)):
        state = plant.step(state, [0.3 * np.sin(9 * (k + 0.5) * dt)], [0], i, dt)
    velocity, torque = plant.measure(state, i)
    exact = solve_ivp(hysteretic, (0, end), [*start, 0], "DOP853", args=(h, slip), rtol=1e-9, atol=1e-11, max_step=1e-4)
    assert np.r_[state[:2], velocity] == pytest.approx(exact.y[:4, -1], abs=tolerance)
    assert torque[0] - 31.0 * (state[1] - state[0]) == pytest.approx(exact.y[4, -1], abs=1e-4 * h)
    assert np.count_nonzero(np.abs(exact.y[4]) >= h) > 100  # it slipped


def test_stuck_rate_is_the_frequency_of_the_sticking_springs() -> None:
    robot, q_l, i = ARMS[-1].robot, np.array([0.4, -0.9]), Imperfections(2, hysteresis=[0.2, 0.0], slip=1e-3)
    M_l, stiffness = robot.M_l(q_l), robot.K + np.diag([200.0, 0.0])
    on = {
        M: [np.linalg.solve(inertia, s * stiffness) for s in (1, -1)] for M, inertia in (("l", M_l), ("m", robot.M_m))
    }
    both = np.block([on["l"], on["m"][::-1]])
    assert stuck_rate(i, robot.K, M_l, robot.M_m) ** 2 == pytest.approx(np.linalg.eigvals(both).real.max(), rel=1e-12)
    assert stuck_rate(Imperfections(2), robot.K, M_l, robot.M_m) == 0.0


# Payload.


def field_of(robot: fjr.Robot, links: Any, q: Array, dq: Array) -> Array:
    """Return dx of eq. (36) without effort, with M, C and grad P of an oracle and dp_l/dt = C' dq + forces."""
    n = robot.n
    q_l, q_m, dq_l, dq_m = q[:n], q[n:], dq[:n], dq[n:]
    spring = robot.K @ (q_m - q_l)
    dp_l = links.C(q_l, dq_l).T @ dq_l - links.grad_P(q_l) + spring - robot.D_l @ dq_l
    return np.concatenate([dq, dp_l, -spring - robot.D_m @ dq_m])


def assert_carries(robot: fjr.Robot, links: Any, i: Imperfections, seed: int) -> None:
    """Check that the robot with the payload of i equals the robot whose links are those of the oracle."""
    n, rng = robot.n, np.random.default_rng(seed)
    q, dq = rng.uniform(-1.5, 1.5, 2 * n), rng.uniform(-2, 2, 2 * n)
    plant, off = plant_of(robot), Imperfections(n).vector
    x = plant.state(q, dq, i.vector)
    assert residual(x[2 * n : 3 * n], links.M(q[:n]) @ dq[:n]) <= 1e-12
    wanted, seen = field_of(robot, links, q, dq), derivative(plant, x, np.zeros(n), np.zeros(n), i.vector)
    for block in range(4):
        rows = slice(n * block, n * (block + 1))
        np.testing.assert_allclose(seen[rows], wanted[rows], rtol=1e-10, atol=1e-10 * np.max(np.abs(wanted)))
    np.testing.assert_allclose(plant.measure(started(x), i.vector)[0], dq, rtol=1e-10, atol=1e-12)
    bare = plant.state(np.zeros(2 * n), np.zeros(2 * n), off)
    x = plant.state(q, np.zeros(2 * n), i.vector)
    added = [energy(plant, y, i.vector) - energy(plant, y, off) for y in (x, bare)]
    without = [robot.P_l(q[:n]), robot.P_l(np.zeros(n))]
    with_it = [links.P(q[:n]), links.P(np.zeros(n))]
    assert added[0] - added[1] == pytest.approx(with_it[0] - with_it[1] - without[0] + without[1], rel=1e-9, abs=1e-10)


@seeds
def test_payload_on_a_closed_form_arm_equals_a_heavier_last_link(seed: int) -> None:
    m, d = 0.3, 0.25
    i = Imperfections(1, payload_mass=m, payload_position=(d, 0.0, 0.4))
    assert_carries(fjr.single_link(), SingleLink(0.031 + m * d**2, 0.8 + 9.81 * m * d), i, seed)
    (m1, m2), (_, l2), (c1, c2), (I1, I2) = (PLANAR[f"link_{name}"] for name in ("mass", "length", "com", "inertia"))
    m = 0.7
    total = m2 + m
    com = (m2 * c2 + m * l2) / total
    inertia = I2 + m2 * (c2 - com) ** 2 + m * (l2 - com) ** 2
    links = PlanarTwoLink((m1, total), PLANAR["link_length"][0], (c1, com), (I1, inertia))
    i = Imperfections(2, payload_mass=m, payload_position=(l2, 0.0, 0.0))
    assert_carries(fjr.planar_two_link(), links, i, seed)


def loaded(links: PinocchioLinks, joint: str, mass: float, position: Array) -> PinocchioLinks:
    """Return the oracle with the point mass added to the body that the joint moves."""
    point = pin.Inertia(mass, position, np.zeros((3, 3)))
    links.model.appendBodyToJoint(links.model.getJointId(joint), point, pin.SE3.Identity())
    links.data = links.model.createData()
    return links


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (3, 1), (7, 0)])
def test_payload_on_any_urdf_equals_an_added_body_in_pinocchio(n: int, seed: int) -> None:
    """The payload is on the link of the outermost named joint, for any order and type of joints, with others locked."""
    case = random_urdf(n, seed)
    robot = fjr.robot_from_urdf(case.xml, case.joints, 100.0, 0.1, 0.3, 0.05, gravity=case.gravity, locked=case.locked)
    position = np.random.default_rng(seed).uniform(-0.4, 0.4, 3)
    i = Imperfections(n, payload_mass=1.3, payload_position=position)
    assert_carries(robot, loaded(case.pinocchio, f"named{n - 1}", 1.3, position), i, seed)


def test_a_payload_without_an_end_effector_frame_and_imperfections_of_other_joints_are_refused() -> None:
    links = closed_form(1, lambda q: 0.1 + 0 * q, lambda q: -q[0])
    plant = plant_of(fjr.Robot(links, *([[value]] for value in (0.1, 10.0, 0.1, 0.1, 1.0))))
    plant.check(Imperfections(1, coulomb_l=0.1))
    with pytest.raises(fjr.ParameterError, match="payload_mass"):
        plant.check(Imperfections(1, payload_mass=0.1))
    with pytest.raises(fjr.ParameterError, match="2 joints; expected 1"):
        plant.check(Imperfections(2))
    state = plant.step(np.zeros(6), [0], [0], Imperfections(1).vector, DT)
    assert np.isfinite(state).all()


# Actuators.


def test_actuator_lag_has_the_exact_step_response() -> None:
    T, plant = np.array([0.003, 0.02]), plant_of(fjr.planar_two_link())
    i, u = Imperfections(2, lag=T).vector, np.array([2.0, -1.0])
    state = np.zeros(12)
    for k in range(1, 41):
        state = plant.step(state, u, [0, 0], i, DT)
        np.testing.assert_allclose(state[8:10], u * (1 - np.exp(-k * DT / T)), rtol=1e-12)
    np.testing.assert_allclose(plant.applied(state[8:10], u, i), state[8:10], rtol=1e-15)


@pytest.mark.parametrize(("integrator", "order"), [("rk4", 4), ("implicit_midpoint", 2)])
def test_actuator_lag_preserves_the_order_of_the_integrator(integrator: str, order: int) -> None:
    """The error of the motion under a(t) = u (1 - exp(-t/T)) has the order of the integrator."""
    plant = plant_of(fjr.single_link(), integrator=integrator)
    i, start = Imperfections(1, lag=0.02).vector, started(fjr.single_link().state([0.3], [0.2], [0.5], [1.0]))

    def end(steps: int) -> Array:
        state = start
        for _ in range(steps):
            state = plant.step(state, [5.0], [0.0], i, 0.04 / steps)
        return state[:4]

    exact = end(640 if order == 4 else 3840)
    errors = [np.max(np.abs(end(steps) - exact)) for steps in (40, 80)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize("lag", [0.0, 0.01])
def test_command_is_saturated_exactly_and_before_the_lag(lag: float) -> None:
    plant, i = plant_of(fjr.planar_two_link()), Imperfections(2, effort_limit=(1.5, np.inf), lag=lag).vector
    inside, beyond = (plant.step(np.zeros(12), u, [0, 0], i, DT) for u in ([-1.5, 7.0], [-99.0, 7.0]))
    assert np.array_equal(inside, beyond)
    assert np.array_equal(
        plant.applied([0, 0], [-99.0, 7.0], Imperfections(2, effort_limit=(1.5, np.inf)).vector), [-1.5, 7]
    )
