# SPDX-License-Identifier: Apache-2.0
"""Identities of elastic structure preserving control, the friction observer and active disturbance rejection."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import signal

import fjr_core as fjr
from core.oracles.cases import ARMS, PLANAR, Arm, Array, random_point
from core.oracles.plain_loop import STIFF, PlainLoop, constant_jets, standard_law
from core.oracles.properties import residual
from core.robust.test_robust import pushed, sampled_run
from fjr_core.extensions.law_registry import LAWS
from fjr_core.law.interfaces import SampledLaw
from fjr_core.law.linearized import equilibria_at, slope_at_rest
from fjr_core.robust.law import Robust, sampled_law
from fjr_core.stability.linear_controller import plant_in_velocities
from fjr_design.baselines.feedback_linearisation import companion

arms = pytest.mark.parametrize("arm", STIFF, ids=lambda arm: arm.name)
seeds = pytest.mark.parametrize("seed", range(2))
OBSERVED = ("friction_observer", "active_disturbance")
PERIOD = 1e-3  # s


@arms
@seeds
def test_loop_of_elastic_structure_is_an_arm_on_its_springs(arm: Arm, seed: int) -> None:
    """M_l dde + (C + D_l + D) de = K (eta - e), M_m ddeta + (D_m + D_eta) deta + K_eta eta = -K (eta - e)."""
    loop, p = PlainLoop(arm, standard_law("elastic_structure", arm)), random_point(arm, seed, same=True)
    g = loop.law.arrays

    def eta_of(x: Array, jets: Array) -> Array:
        q, theta, dq, _ = loop.parts(x)
        inertial = arm.links.M(q) @ jets[2] + (arm.links.C(q, dq) + arm.D_l) @ jets[1] + arm.links.grad_P(q)
        return theta - jets[0] - np.linalg.solve(arm.K, inertial - g["D"] @ (dq - jets[1]))

    q, _, dq, _ = loop.parts(p.x)
    e, de, dde = q - p.jets[0], dq - p.jets[1], loop.ddq(p.x) - p.jets[2]
    eta, deta = eta_of(p.x, p.jets), loop.rate_of(eta_of, p.x, p.jets)
    ddeta, spring = loop.rate_of(loop.along(eta_of), p.x, p.jets), arm.K @ (eta - e)
    M, C = arm.links.M(q), arm.links.C(q, dq)
    assert residual(M @ dde, -C @ de, -(arm.D_l + g["D"]) @ de, spring) < 1e-8
    assert residual(arm.M_m @ ddeta, -(arm.D_m + g["D_eta"]) @ deta, -g["K_eta"] @ eta, -spring) < 1e-6
    V = (de @ M @ de + deta @ arm.M_m @ deta + (eta - e) @ spring + eta @ g["K_eta"] @ eta) / 2
    assert loop.storage(p.x, p.jets) == pytest.approx(V, rel=1e-8)
    lost = -de @ (arm.D_l + g["D"]) @ de, -deta @ (arm.D_m + g["D_eta"]) @ deta
    assert residual(loop.rate_of(loop.storage, p.x, p.jets), *lost) < 1e-7


def run(law: SampledLaw, arm: Arm, seconds: float, push: Any = 0.0, period: float = PERIOD) -> dict[str, Array]:
    """Return e about a constant reference, u and memory, (k, n) each, under torques push (2n,) of links and motors."""
    n, q_d, robot = arm.n, np.full(arm.n, 0.4), arm.robot
    d_l, d_m = np.split(np.broadcast_to(np.asarray(push, dtype=float), 2 * n), 2)
    x = robot.state(q_d, q_d + np.linalg.solve(robot.K, robot.grad_P_l(q_d)), np.zeros(n), np.zeros(n))
    states, u, memory = sampled_run(law, pushed(robot, d_l), x, constant_jets(q_d), seconds, period, d_m)
    return {"e": states[:, :n] - q_d, "theta": states[:, n : 2 * n], "u": u, "memory": memory}


@arms
def test_friction_observer_is_motor_pd_on_the_exact_model_and_removes_a_torque_on_the_motors(arm: Arm) -> None:
    """Its compensation is (L s + L L_p) / (s^2 + (D_m / M_m + L) s + L L_p) times this torque."""
    law, n, push = standard_law("friction_observer", arm), arm.n, 0.05
    plain = standard_law("pd_feedforward", arm)
    np.testing.assert_allclose(run(law.sampled, arm, 0.2)["u"], run(plain, arm, 0.2)["u"], rtol=1e-6, atol=1e-9)
    found = run(law.sampled, arm, 1.5, np.r_[np.zeros(n), np.full(n, push)])
    compensation, L, L_p = found["memory"][:, 3 * n :], law.arrays["L"][0], law.arrays["L_p"][0]
    np.testing.assert_allclose(compensation[-1], -push, rtol=2e-3)
    if arm.name.startswith("single"):
        rate = arm.D_m[0, 0] / arm.M_m[0, 0] + L
        t, wanted = signal.step(([L, L * L_p], [1.0, rate, L * L_p]), T=PERIOD * np.arange(len(compensation)))
        assert np.abs(compensation[:, 0] + push * wanted).max() < 0.05 * push


def test_active_disturbance_places_the_poles_of_the_chain_if_nothing_is_lacking() -> None:
    """Without weight and friction the linear loop of the static law has the poles of A_0 .. A_3."""
    free = {"gravity": 0.0, "link_damping": 0.0, "motor_damping": 0.0}
    robot = fjr.planar_two_link(**PLANAR | free, stiffness=31.0, motor_inertia=(0.02, 0.01), input_gain=1.0)
    kind, q_0 = LAWS["active_disturbance"], np.array([0.3, -0.5])
    law = kind.make(robot, kind.tuning_rule(robot, q_0, 12.0, 0.9))
    (A,), (B,) = plant_in_velocities(equilibria_at(robot, q_0[None]))
    poles = np.sort_complex(np.linalg.eigvals(A + B @ slope_at_rest(law, q_0)[0]))
    wanted = np.sort_complex(np.linalg.eigvals(companion(*(law.arrays[f"A_{k}"] for k in range(4)))))
    np.testing.assert_allclose(poles, wanted, rtol=1e-5)


def test_observer_of_active_disturbance_has_its_poles_at_the_bandwidth() -> None:
    """One step of the estimates of a joint, linear in them, has the eigenvalue exp(-bandwidth dt) three times."""
    law = standard_law("active_disturbance", ARMS[0]).sampled
    values = [np.zeros(2), np.zeros(2), np.zeros((1, 5)), law.gain_values, law.memory, 0.0, PERIOD]

    def after(memory: Array) -> Array:
        values[4] = memory
        return np.asarray(law.step_function(*values)[2].full().ravel())

    columns = np.array([after(unit) - after(np.zeros(8)) for unit in np.eye(8)])[:6, :6].T
    wanted = np.exp(-law.law.arrays["bandwidth"][0] * PERIOD)  # type: ignore[attr-defined]
    for side in (slice(0, 6, 2), slice(1, 6, 2)):
        characteristic = np.poly(columns[side, side])
        np.testing.assert_allclose(characteristic, np.poly([wanted] * 3), rtol=1e-9)


@arms
def test_active_disturbance_leaves_no_error_of_constant_torques_on_links_and_motors(arm: Arm) -> None:
    law = standard_law("active_disturbance", arm)
    found = run(law.sampled, arm, 3.0, np.linspace(0.05, -0.05, 2 * arm.n))
    assert np.abs(found["e"][:1000]).max() > 1e-4
    assert np.abs(found["e"][-1]).max() < 1e-6


@pytest.mark.parametrize("name", OBSERVED)
def test_law_with_an_observer_of_its_own_refuses_a_second_one_and_keeps_its_functions_for_other_gains(
    name: str,
) -> None:
    law = standard_law(name, ARMS[0], 20.0)
    for robust in (Robust(residual_gain=5.0), Robust(integral_gain=5.0), Robust(delay=1e-3)):
        with pytest.raises(fjr.GainsError, match=f"{type(law).__name__} estimates .*expected robust.* of 0"):
            sampled_law(law, robust)
    as_run, other = law.sampled, standard_law(name, ARMS[0], 30.0)
    again = as_run.with_law(law.with_gains(other.gains))  # type: ignore[attr-defined]
    assert again.step_function is as_run.step_function
    np.testing.assert_array_equal(again.gain_values, other.sampled.gain_values)
