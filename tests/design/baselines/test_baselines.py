# SPDX-License-Identifier: Apache-2.0
"""Common properties of the baseline laws: equilibrium, motion along the reference, gains, machine code."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import ARMS, Arm, random_point
from core.oracles.plain_loop import OTHERS, STIFF, PlainLoop, constant_jets, standard_law
from fjr_core.extensions.law_registry import LAWS
from fjr_core.law.interfaces import StaticLaw
from fjr_design.baselines.backstepping import BacksteppingGains
from fjr_design.baselines.feedback_linearisation import CompositeGains, LinearErrorGains
from fjr_design.baselines.lqr import LqrGains
from fjr_design.baselines.pd_gravity import PdGains
from fjr_design.baselines.torque_feedback import TorqueFeedbackGains

REGULATORS = ("pd_gravity", "torque_feedback")  # proven for constant references, without feedforward
names = pytest.mark.parametrize("name", OTHERS)
every_law = pytest.mark.parametrize("name", LAWS)
arms = pytest.mark.parametrize("arm", STIFF, ids=lambda arm: arm.name)


@every_law
@arms
def test_effort_at_the_equilibrium_is_the_gravity_torque(name: str, arm: Arm) -> None:
    loop = PlainLoop(arm, standard_law(name, arm))
    q = np.random.default_rng(1).uniform(-1, 1, arm.n)
    x, jets = loop.equilibrium(q), constant_jets(q)
    weight = np.linalg.solve(arm.B_m, arm.links.grad_P(q))
    np.testing.assert_allclose(loop.effort(x, jets), weight, rtol=1e-11, atol=1e-13)
    V = loop.storage(x, jets)
    rounding = 1e-14 if name.startswith("torque_feedback") else 1e-25  # J; V is a difference of potentials there
    assert abs(V) < rounding if LAWS[name].storage else np.isnan(V)


@pytest.mark.parametrize("name", [name for name in LAWS if name not in REGULATORS])
@arms
def test_effort_on_a_moving_reference_is_the_inverse_dynamics(name: str, arm: Arm) -> None:
    """All tracking laws agree where all errors are zero; the oracle differentiates closed forms."""
    loop = PlainLoop(arm, standard_law(name, arm))
    for seed in range(3):
        jets = random_point(arm, seed).jets
        x, u = loop.on_reference(jets)
        scale = max(1.0, float(np.abs(u).max()))
        np.testing.assert_allclose(loop.effort(x, jets), u, atol=1e-7 * scale)


@names
@arms
def test_storage_is_positive_away_from_the_reference_or_absent(name: str, arm: Arm) -> None:
    loop = PlainLoop(arm, standard_law(name, arm))
    for seed in range(10):
        p = random_point(arm, seed, same=True)
        V = loop.storage(p.x, p.jets)
        assert V > 0 if LAWS[name].storage else np.isnan(V)


@names
def test_every_gain_changes_the_effort(name: str) -> None:
    """At a random state, and with an observer at a random state of it."""
    arm = ARMS[-1]
    law, p = standard_law(name, arm), random_point(arm, 5, same=True)
    q, theta, dq, dtheta = PlainLoop(arm, law).parts(p.x)

    def effort(law: StaticLaw) -> np.ndarray:
        run, memory = law.sampled, np.random.default_rng(1).uniform(-1, 1, len(law.sampled.memory))
        given = np.r_[q, theta], np.r_[dq, dtheta], p.jets.T, run.gain_values, memory, np.ones(arm.n), 1e-3
        return np.asarray(run.step_function(*given)[0].full().ravel())

    before = effort(law)
    for field in fields(law.gains):
        value = np.asarray(getattr(law.gains, field.name))
        changed = value + 0.3 if field.name == "configuration" else value * (0.8 if field.name == "M_theta" else 1.1)
        changed = float(changed) if changed.ndim == 0 else changed
        other = law.with_gains(replace(law.gains, **{field.name: changed}))
        assert np.abs(effort(other) - before).max() > 1e-6, field.name


@names
def test_all_evaluation_functions_agree(name: str) -> None:
    """Compare `measured_command`, the command of a state and the SampledLaw of the law."""
    arm = ARMS[2]
    law, loop = standard_law(name, arm), PlainLoop(arm, standard_law(name, arm))
    p = random_point(arm, 3, same=True)
    q, theta, dq, dtheta = loop.parts(p.x)
    position, velocity, jets = np.r_[q, theta], np.r_[dq, dtheta], np.ascontiguousarray(p.jets)
    u, V = law.measured_command(position, velocity, jets)
    np.testing.assert_allclose(law.command(p.x, jets), u, rtol=1e-9)
    np.testing.assert_allclose(float(law.command_function(p.x, jets.T)[1]), V, rtol=1e-9)
    step = law.step_function(position, velocity, jets.T, law.gain_values, np.zeros(0), np.zeros(2), 1e-3)
    np.testing.assert_allclose(step[0].full().ravel(), u, rtol=1e-12)


@names
def test_tracks_the_sine_of_the_paper_at_1_khz(name: str) -> None:
    """The run starts with an error of 0.5 rad. Regulators lack the feedforward and keep an error below 0.1 rad."""
    arm = ARMS[0]
    law = standard_law(name, arm, 40.0, 0.8)
    x0 = arm.robot.state(0.5, 0.5, 0.0, 0.0)
    run = fjr.simulate(fjr.Plant(arm.robot), law, fjr.Sine(1.0, 1.0), x0, 5.0, 1e-3)
    late = np.abs(run.x[3000:, 0] - run.jets[3000:, 0, 0]).max()
    assert late < (0.1 if name in REGULATORS else 1e-3)


BAD_GAINS = [
    (PdGains(K_p=-1.0, K_d=1.0), "K_p"),
    (PdGains(K_p=0.1, K_d=1.0), "outweigh gravity"),
    (PdGains(K_p=np.nan, K_d=1.0), "finite"),
    (PdGains(K_p=20.0, K_d=-1.0), "K_d with the robot's own damping"),
    (CompositeGains(K_p=-1.0, K_v=1.0, K_f=1.0), "slow mode that grows"),
    (CompositeGains(K_p=1.0, K_v=1.0, K_f=[1.0, 2.0, 3.0]), "shape"),
    (LinearErrorGains(1.0, 1.0, 1.0, 1.0), "error that grows"),
    (BacksteppingGains(Lambda=0.0, K_1=1.0, c_1=1.0, c_2=1.0), "positive number"),
    (BacksteppingGains(Lambda=1.0, K_1=-1.0, c_1=1.0, c_2=1.0), "K_1"),
    (TorqueFeedbackGains(M_theta=1.0, K_theta=20.0, D_theta=1.0), "at most 1"),
    (TorqueFeedbackGains(M_theta=0.001, K_theta=-0.1, D_theta=1.0), "K_theta"),
    (LqrGains(Q=np.diag([-1.0, 0, 0, 0]), R=1.0, configuration=0.0), "Q"),
    (LqrGains(Q=np.eye(4), R=0.0, configuration=0.0), "R"),
    (LqrGains(Q=np.eye(4), R=1.0, configuration=[0.0, 1.0]), "configuration"),
    (LqrGains(Q=1e200 * np.eye(4), R=1.0, configuration=0.0), "Q and R give a Riccati equation without a solution"),
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("gains", "words"), BAD_GAINS, ids=lambda value: getattr(value, "__class__", type(value)).__name__
)
def test_gains_that_violate_the_condition_of_the_paper_are_refused(gains: object, words: str) -> None:
    with pytest.raises(fjr.GainsError, match=words):
        gains.arrays(ARMS[0].robot)  # type: ignore[attr-defined]
