# SPDX-License-Identifier: Apache-2.0
"""Each baseline has the identity or stability property of its paper along the arm, also with seven joints."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import root

import fjr_core as fjr
from core.oracles.cases import ARMS, Arm, Array, Point, random_point
from core.oracles.chains import arm7
from core.oracles.oracle import jacobian, stencil
from core.oracles.plain_loop import STIFF, PlainLoop, constant_jets, standard_law
from core.oracles.properties import residual
from fjr_core.extensions.law_registry import LAWS
from fjr_core.law.gains import relative_eigenvalues
from fjr_core.law.linearized import equilibria_at
from fjr_core.stability.linear_controller import plant_in_velocities
from fjr_design.baselines import feedback_linearisation, pd_gravity, torque_feedback
from fjr_design.baselines.backstepping import BacksteppingGains
from fjr_design.baselines.torque_feedback import TorqueFeedbackGains

TOLERANCE = 1e-8
arms = pytest.mark.parametrize("arm", [*STIFF, arm7()], ids=lambda arm: arm.name)
stiff = pytest.mark.parametrize("arm", STIFF, ids=lambda arm: arm.name)
seeds = pytest.mark.parametrize("seed", range(2))


@cache
def loop_of(name: str, arm: Arm) -> PlainLoop:
    return PlainLoop(arm, standard_law(name, arm))


def place(arm: Arm, seed: int) -> Point:
    return random_point(arm, seed, same=True)


# motor-side laws: storage for a constant reference

ON_MOTORS = ["pd_gravity", "pd_feedforward", "torque_feedback", "torque_feedback_feedforward"]


def on_motors(loop: PlainLoop, gain: str) -> Array:
    """Return K_p or K_theta for "K", K_d or D_theta for "D"."""
    arrays = loop.law.arrays  # type: ignore[attr-defined]
    names = {"K": ("K_p", "K_theta"), "D": ("K_d", "D_theta")}[gain]
    return np.asarray(next(arrays[name] for name in names if name in arrays))


@pytest.mark.parametrize("name", ON_MOTORS)
@arms
@seeds
def test_storage_of_a_constant_reference_decays_by_the_damping_alone(name: str, arm: Arm, seed: int) -> None:
    """dV/dt = -dq' D_l dq - dtheta' (D_m + D) dtheta in every state."""
    loop, p = loop_of(name, arm), place(arm, seed)
    D = on_motors(loop, "D")
    jets = constant_jets(p.jets[0])
    _, _, dq, dtheta = loop.parts(p.x)
    dV = loop.rate_of(loop.storage, p.x, jets, np.zeros_like(jets))
    assert residual(dV, -dq @ arm.D_l @ dq, -dtheta @ (arm.D_m + D) @ dtheta) < TOLERANCE


@pytest.mark.parametrize("name", ["pd_gravity", "torque_feedback"])
@arms
@seeds
def test_feedforward_is_that_of_the_reference_alone(name: str, arm: Arm, seed: int) -> None:
    """For a constant reference, effort and storage in every state are those of the law without feedforward."""
    plain, p = loop_of(name, arm), place(arm, seed)
    law = LAWS[f"{name}_feedforward" if name == "torque_feedback" else "pd_feedforward"]
    with_feedforward = PlainLoop(arm, law.make(arm.robot, plain.law.gains))  # type: ignore[attr-defined]
    jets = constant_jets(p.jets[0])
    for of in ("effort", "storage"):
        wanted = getattr(plain, of)(p.x, jets)
        np.testing.assert_allclose(getattr(with_feedforward, of)(p.x, jets), wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["pd_gravity", "torque_feedback"])
@stiff
def test_constant_reference_is_the_only_equilibrium_and_is_attractive(name: str, arm: Arm) -> None:
    """If K_p outweighs gravity, V has one stationary point and the arm converges to it from far away."""
    loop = loop_of(name, arm)
    gain = on_motors(loop, "K")
    assert np.linalg.eigvalsh(pd_gravity.storage_hessians(arm.robot, gain)).min() > 0
    q_d = np.full(arm.n, 0.7)
    x0 = loop.state(np.full(arm.n, -0.8), np.full(arm.n, -1.1), np.full(arm.n, 2.0), np.full(arm.n, -1.0))
    still = fjr.Sine(np.zeros(arm.n), 1.0, q_d)
    run = fjr.simulate(loop.plant, loop.law, still, x0, 15.0, inner_step=5e-4)
    assert np.abs(run.x[-1] - loop.equilibrium(q_d)).max() < 1e-3
    assert np.all(np.diff(run.V[::50]) <= 1e-9), "V must not grow"


def gravity_at_rest(arm: Arm, theta: Array) -> Array:
    """Return the gravity torque (n,) [N m] at equilibrium with motors fixed at theta: K (theta - q) = grad P_l(q)."""
    found = root(lambda q: arm.K @ (theta - q) - arm.links.grad_P(q), theta, tol=1e-14)
    return np.asarray(arm.links.grad_P(found.x))


@pytest.mark.parametrize("name", ON_MOTORS[2:])
@arms
@seeds
def test_torque_feedback_shapes_the_motor_inertia(name: str, arm: Arm, seed: int) -> None:
    """M_theta ddtheta + D_m dtheta + tau = w, with gravity computed from the motor positions."""
    loop, p = loop_of(name, arm), place(arm, seed)
    g = loop.law.arrays  # type: ignore[attr-defined]
    q, theta, _, dtheta = loop.parts(p.x)
    q_d = p.jets[0]
    theta_d = q_d + np.linalg.solve(arm.K, arm.links.grad_P(q_d))
    w = (gravity_at_rest(arm, theta), -g["K_theta"] @ (theta - theta_d), -g["D_theta"] @ dtheta)
    ddtheta = loop.ddtheta(p.x, loop.effort(p.x, constant_jets(q_d)))
    left = g["M_theta"] @ ddtheta
    assert residual(left, *w, -arm.D_m @ dtheta, -arm.K @ (theta - q)) < TOLERANCE


@arms
@seeds
def test_gravity_from_motor_positions_gives_one_equilibrium_for_any_stiffness(arm: Arm, seed: int) -> None:
    """With the links in equilibrium, only -K_theta (theta - theta_d) acts on the motors; K_theta = 0.01 N m/rad."""
    kind, K_theta = LAWS["torque_feedback"], 0.01
    gains = TorqueFeedbackGains(0.3 * arm.M_m, K_theta, 1.0)
    loop = PlainLoop(arm, kind.make(arm.robot, gains))
    p = place(arm, seed)
    x, q_d = loop.equilibrium(p.x[: arm.n]), p.jets[0]
    _, theta, _, _ = loop.parts(x)
    theta_d = q_d + np.linalg.solve(arm.K, arm.links.grad_P(q_d))
    pulled = 0.3 * arm.M_m @ loop.ddtheta(x, loop.effort(x, constant_jets(q_d)))
    weight = np.abs(arm.links.grad_P(q_d)).max()
    np.testing.assert_allclose(pulled, -K_theta * (theta - theta_d), atol=1e-11 * max(1.0, weight))
    at_rest = loop.effort(loop.equilibrium(q_d), constant_jets(q_d))
    np.testing.assert_allclose(arm.B_m @ at_rest, arm.links.grad_P(q_d), rtol=1e-11, atol=1e-12)


def test_gravity_from_motor_positions_is_refused_if_it_outweighs_the_springs() -> None:
    arm = next(arm for arm in ARMS if arm.name == "planar-3.1")
    with pytest.raises(fjr.GainsError, match="stiffness does not outweigh gravity"):
        LAWS["torque_feedback"].make(arm.robot, TorqueFeedbackGains(arm.M_m / 2, 60.0, 1.0))


@pytest.mark.parametrize("sample_period", [1e-2, 1e-3, 1e-4])
def test_shaped_inertia_is_as_small_as_sampling_allows(sample_period: float) -> None:
    for arm in STIFF:
        D = 3.0 * arm.links.M(np.zeros(arm.n))
        M_theta = torque_feedback.shaped_inertia(arm.robot, D, sample_period)
        parts = relative_eigenvalues(M_theta, arm.M_m)
        assert parts.min() >= torque_feedback.SMALLEST_INERTIA - 1e-9
        assert parts.max() <= 1 + 1e-9
        if parts.max() < 1 - 1e-9:
            turn = np.sqrt(relative_eigenvalues(arm.K, M_theta)) * sample_period
            assert turn.max() <= torque_feedback.FASTEST_RESONANCE + 1e-9
            assert relative_eigenvalues(D, M_theta).max() * sample_period <= torque_feedback.FASTEST_DAMPING + 1e-9


# feedback linearisation


@arms
@seeds
def test_feedback_linearisation_gives_linear_error_dynamics_of_order_four(arm: Arm, seed: int) -> None:
    """d4e + A_3 d3e + A_2 dde + A_1 de + A_0 e = 0 along the arm; derivatives are nested differences."""
    loop, p = loop_of("feedback_linearisation", arm), place(arm, seed)
    g = loop.law.arrays  # type: ignore[attr-defined]
    q, _, dq, _ = loop.parts(p.x)
    d3q = loop.along(loop.ddq)
    motion = [q, dq, loop.ddq(p.x), d3q(p.x, p.jets)]
    e = [value - p.jets[k] for k, value in enumerate(motion)]
    d4q = loop.rate_of(d3q, p.x, p.jets)
    assert residual(d4q, p.jets[4], *(-g[f"A_{k}"] @ e[k] for k in range(4))) < 1e-6
    z = np.concatenate(e)
    Q = feedback_linearisation.weight(g["A_0"])
    assert abs(loop.storage(p.x, p.jets) - z @ g["P"] @ z / 2) < 1e-6 * loop.storage(p.x, p.jets)
    assert residual(loop.rate_of(loop.storage, p.x, p.jets), -z @ Q @ z / 2) < 1e-5


@arms
def test_feedback_linearisation_has_two_time_scales(arm: Arm) -> None:
    """Each joint has two poles at omega and a pair at half its elastic mode, bounded by omega and the sample rate."""
    n, omega, q_0 = arm.n, 10.0, np.full(arm.n, 0.3)
    inverse = np.linalg.inv(arm.links.M(q_0)) + np.linalg.inv(arm.M_m)
    modes = np.sort(np.sqrt(np.linalg.eigvals(inverse @ arm.K).real))
    for sample_period in (1e-6, 1e-3):
        gains = feedback_linearisation.LinearErrorGains.standard(arm.robot, q_0, omega, 1.0, sample_period)
        arrays = gains.arrays(arm.robot)
        poles = np.linalg.eigvals(feedback_linearisation.companion(*(arrays[f"A_{k}"] for k in range(4))))
        size = np.sort(np.abs(poles))
        fastest = feedback_linearisation.FASTEST_POLE / sample_period
        wanted = np.clip(np.repeat(modes / 2, 2), omega, fastest)
        np.testing.assert_allclose(size, np.sort(np.r_[np.full(2 * n, omega), wanted]), rtol=1e-4)
        assert poles.real.max() < -0.69 * omega


# backstepping


def motor_errors(loop: PlainLoop, own: bool):
    """Return theta - theta_d of state and jets; own: theta_d from q (backstepping), otherwise from q_d (passivity)."""
    arm, g = loop.arm, loop.law.arrays  # type: ignore[attr-defined]

    def e_m(x: Array, jets: Array) -> Array:
        q, theta, dq, _ = loop.parts(x)
        e, de = q - jets[0], dq - jets[1]
        dq_r, ddq_r = jets[1] - g["Lambda"] * e, jets[2] - g["Lambda"] * de
        C = arm.links.C(q, dq)
        tau_d = arm.links.M(q) @ ddq_r + (C + arm.D_l) @ dq_r + arm.links.grad_P(q) - g["K_1"] @ (dq - dq_r)
        return theta - (q if own else jets[0]) - np.linalg.solve(arm.K, tau_d)

    return e_m


@arms
@seeds
def test_exact_rate_of_the_storage_of_backstepping(arm: Arm, seed: int) -> None:
    loop, p = loop_of("backstepping", arm), place(arm, seed)
    g, x, jets = loop.law.arrays, p.x, p.jets  # type: ignore[attr-defined]
    q, _, dq, _ = loop.parts(x)
    e, de = q - jets[0], dq - jets[1]
    s, D_1, Lambda = de + g["Lambda"] * e, g["K_1"] + arm.D_l, g["Lambda"][0]
    e_m, de_m = motor_errors(loop, True)(x, jets), loop.rate_of(motor_errors(loop, True), x, jets)
    s_m = de_m + g["c_1"] * e_m + s
    V = (s @ arm.links.M(q) @ s + e_m @ arm.K @ e_m + s_m @ arm.M_m @ s_m) / 2 + Lambda * e @ D_1 @ e
    assert abs(loop.storage(x, jets) / V - 1) < TOLERANCE
    lost = (de @ D_1 @ de, Lambda**2 * e @ D_1 @ e, g["c_1"][0] * e_m @ arm.K @ e_m, g["c_2"][0] * s_m @ arm.M_m @ s_m)
    assert residual(loop.rate_of(loop.storage, x, jets), *(-term for term in lost)) < 1e-7


@stiff
@seeds
def test_backstepping_with_these_weights_is_the_passivity_based_law(arm: Arm, seed: int) -> None:
    """With c_1 = Lambda, c_2 M_m = K_2 + D_m: B_m u = M_m ddtheta_r + D_m dtheta_r + K (theta_d - q_d) - K_2 s_m."""
    Lambda, c_2 = 12.0, 17.0
    kind = LAWS["backstepping"]
    loop = PlainLoop(arm, kind.make(arm.robot, BacksteppingGains(Lambda, 0.9, c_1=Lambda, c_2=c_2)))
    p = place(arm, seed)
    e_m = motor_errors(loop, False)
    de_m = loop.along(e_m)
    _, theta, _, dtheta = loop.parts(p.x)
    e, de, dde = e_m(p.x, p.jets), de_m(p.x, p.jets), loop.rate_of(de_m, p.x, p.jets)
    ddtheta = loop.ddtheta(p.x, loop.effort(p.x, p.jets))
    ddtheta_r, s_m = ddtheta - dde - Lambda * de, de + Lambda * e
    K_2 = c_2 * arm.M_m - arm.D_m
    terms = (arm.M_m @ ddtheta_r, arm.D_m @ (dtheta - s_m), arm.K @ (theta - e - p.jets[0]), -K_2 @ s_m)
    assert residual(arm.B_m @ loop.effort(p.x, p.jets), *terms) < 1e-6


# singular perturbation


def slow_torque(loop: PlainLoop):
    """Return theta_s(x, jets) of the slow manifold, and v."""
    arm, g = loop.arm, loop.law.arrays  # type: ignore[attr-defined]

    def v(q: Array, dq: Array, jets: Array) -> Array:
        return np.asarray(jets[2] - g["K_v"] @ (dq - jets[1]) - g["K_p"] @ (q - jets[0]))

    def theta_s(q: Array, dq: Array, jets: Array) -> Array:
        return q + np.linalg.solve(arm.K, arm.links.M(q) @ v(q, dq, jets) + loop.bias(q, dq))

    return v, theta_s


@arms
@seeds
def test_corrected_slow_manifold_is_invariant_and_its_links_move_like_the_rigid_arm(arm: Arm, seed: int) -> None:
    loop, p = loop_of("singular_perturbation", arm), place(arm, seed)
    v, theta_s = slow_torque(loop)
    q, _, dq, _ = loop.parts(p.x)
    rates = np.vstack([p.jets[1:], np.zeros(arm.n)])

    def dtheta_s(q: Array, dq: Array, jets: Array) -> Array:
        ddq, djets = v(q, dq, jets), np.vstack([jets[1:], np.zeros(arm.n)])
        return np.asarray(stencil(lambda s: theta_s(q + s * dq, dq + s * ddq, jets + s * djets), 2e-3))

    ddq = v(q, dq, p.jets)
    x = loop.state(q, theta_s(q, dq, p.jets), dq, dtheta_s(q, dq, p.jets))
    assert residual(loop.ddq(x), ddq) < TOLERANCE
    wanted = stencil(lambda s: dtheta_s(q + s * dq, dq + s * ddq, p.jets + s * rates), 2e-3)
    assert residual(loop.ddtheta(x, loop.effort(x, p.jets)), wanted) < 1e-6


def test_distance_to_the_rigid_arm_shrinks_with_stiffness() -> None:
    """Started off the manifold, the distance of the link from the rigid arm scales with K^-1/2."""
    wrong = []
    for stiffness in (31.0, 310.0, 3100.0, 31000.0):
        robot = fjr.single_link(stiffness=stiffness)
        kind = LAWS["singular_perturbation"]
        law = kind.make(robot, kind.tuning_rule(robot, np.zeros(1), 8.0, 0.7))  # type: ignore[misc]
        x0 = robot.state(0.5, 0.5, 0.0, 0.0)
        run = fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), x0, 1.0, inner_step=5e-5)
        t, e0, de0 = run.t, 0.5, -1.0
        rigid = np.exp(-8 * t) * (e0 + (de0 + 8 * e0) * t)
        wrong.append(float(np.abs(run.x[:, 0] - run.jets[:, 0, 0] - rigid).max()))
    ratios = np.array(wrong[:-1]) / np.array(wrong[1:])
    assert np.all(ratios > 2.0), wrong
    assert wrong[-1] < 1e-3


# LQR


def matrices(loop: PlainLoop, q_0: Array) -> tuple[Array, Array]:
    """Return A and B of the linearisation in (q, theta, dq, dtheta), by differences of Plant.derivative."""
    x = loop.equilibrium(q_0)
    u = np.linalg.solve(loop.arm.B_m, loop.arm.links.grad_P(q_0))
    T = np.kron(np.eye(4), np.eye(loop.arm.n))
    n = loop.arm.n
    T[2 * n : 3 * n, 2 * n : 3 * n] = np.linalg.inv(loop.arm.links.M(q_0))
    T[3 * n :, 3 * n :] = np.linalg.inv(loop.arm.M_m)
    A = jacobian(lambda y: loop.plant.derivative(y, u), x, np.full(4 * n, 0.02))
    B = jacobian(lambda w: loop.plant.derivative(x, w), u, np.full(n, 1.0))
    return T @ A @ np.linalg.inv(T), T @ B


@arms
def test_lqr_minimises_its_cost(arm: Arm) -> None:
    """The Riccati residual vanishes, the poles are stable, and no feedback near F has a lower cost."""
    loop, q_0 = loop_of("lqr", arm), np.zeros(arm.n)
    A, B = matrices(loop, q_0)
    gains, g = loop.law.gains, loop.law.arrays  # type: ignore[attr-defined]
    Q, R, P, F = np.asarray(gains.Q), np.asarray(gains.R), g["P"], g["F"]
    W = np.linalg.inv(np.linalg.cholesky(P + 1e-9 * np.trace(P) * np.eye(len(P))))
    terms = (P @ A + A.T @ P, -P @ B @ np.linalg.solve(R, B.T @ P), Q)
    assert np.abs(W @ sum(terms) @ W.T).max() < 1e-5 * max(np.abs(W @ t @ W.T).max() for t in terms)
    np.testing.assert_allclose(F, np.linalg.solve(R, B.T @ P), rtol=1e-5, atol=1e-6 * np.abs(F).max())
    assert np.linalg.eigvals(A - B @ F).real.max() < 0

    def cost(feedback: Array) -> float:
        closed = A - B @ feedback
        return float(np.trace(solve_continuous_lyapunov(closed.T, -(Q + feedback.T @ R @ feedback)) @ W.T @ W))

    rng = np.random.default_rng(0)
    least = cost(F)
    for _ in range(5):
        nudge = 0.02 * np.abs(F).max(axis=1, keepdims=True) * rng.standard_normal(F.shape) * (np.abs(F) > 0)
        for sign in (1, -1):
            if np.linalg.eigvals(A - B @ (F + sign * nudge)).real.max() < 0:
                assert cost(F + sign * nudge) > least


@arms
def test_lqr_storage_decays_by_the_running_cost_for_small_errors(arm: Arm) -> None:
    """dV/dt = -(x' Q x + u' R u) / 2 to second order about the configuration."""
    loop, q_0 = loop_of("lqr", arm), np.zeros(arm.n)
    gains, g = loop.law.gains, loop.law.arrays  # type: ignore[attr-defined]
    rng = np.random.default_rng(3)
    error = 1e-5 * rng.standard_normal(4 * arm.n)
    q, theta, dq, dtheta = np.split(error, 4)
    rest_q, rest_theta, _, _ = loop.parts(loop.equilibrium(q_0))
    x = loop.state(rest_q + q, rest_theta + theta, dq, dtheta)
    jets = constant_jets(q_0)
    dV = loop.rate_of(loop.storage, x, jets, np.zeros_like(jets))
    u = g["F"] @ error
    assert abs(dV / (-(error @ np.asarray(gains.Q) @ error + u @ np.asarray(gains.R) @ u) / 2) - 1) < 1e-3


def test_lqr_uses_the_linearisation_of_the_robot() -> None:
    for arm in STIFF:
        q_0 = np.full(arm.n, 0.4)
        own = plant_in_velocities(equilibria_at(arm.robot, q_0[None]))
        for (seen,), wanted in zip(own, matrices(loop_of("lqr", arm), q_0), strict=True):
            np.testing.assert_allclose(seen, wanted, atol=1e-7 * np.abs(wanted).max())
