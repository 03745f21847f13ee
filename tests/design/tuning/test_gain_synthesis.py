# SPDX-License-Identifier: Apache-2.0
"""Synthesised gains: required rate, stable sampled loop, and one sentence if no gains exist."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.chains import arm7
from design.stability.test_sampled_loop import chain3
from fjr_core.law.linearized import equilibria_at
from fjr_core.motions.domain import Domain
from fjr_core.stability.linearization import closed_form
from fjr_design.stability.sampled_loop import check, lag_limit, late_spring
from fjr_design.tuning.gain_synthesis import synthesize
from fuzzing import refused

HOME = np.array([0, 0.5, 0.2, -1.2, -0.2, 0.8, 0.4])


@cache
def robot(name: str) -> fjr.Robot:
    if name == "arm7":
        return arm7().robot
    return {
        "paper": fjr.single_link,
        "soft": lambda: fjr.single_link(stiffness=3.1),
        "planar": fjr.planar_two_link,
        "full": lambda: fjr.planar_two_link(
            [[40.0, 5.0], [5.0, 25.0]], motor_inertia=[[0.02, 0.003], [0.003, 0.01]], input_gain=[[1.2, 0.1], [0, 0.8]]
        ),
        "chain": lambda: chain3(np.random.default_rng(3)),
    }[name]()


def elsewhere(arm: fjr.Robot, k: int = 800) -> np.ndarray:
    """Return random configurations that neither check nor synthesis uses, half of them with aligned axes."""
    rng, limits = np.random.default_rng(11), arm.limits
    lower, upper = (limits.lower, limits.upper) if limits else (-np.pi, np.pi)
    q_l = rng.uniform(lower, upper, (k, arm.n))
    q_l[k // 2 :] *= rng.random((k - k // 2, arm.n)) < 0.5
    return q_l


BETWEEN = 3e-3  # allowed excess of the radius between the sampled configurations


@pytest.mark.parametrize(
    ("name", "beta", "period", "delay"),
    [
        ("paper", 3.0, 5e-3, 5e-3),
        ("soft", 8.0, 2e-3, 1e-3),
        ("full", 5.0, 2e-3, 0.0),
        ("chain", 3.0, 1e-3, 0.5e-3),
        pytest.param("arm7", 3.0, 1e-3, 0.0, marks=pytest.mark.full),
    ],
)
def test_synthesised_gains_have_the_rate_and_half_a_sample_of_margin(
    name: str, beta: float, period: float, delay: float
) -> None:
    law = fjr.TrackingLaw(robot(name), synthesize(robot(name), beta, period, delay))
    rate, found = law.rate(), check(law, period, delay, lowest_rate=False)
    assert min(rate.beta_l, rate.beta_m, rate.beta_sigma_l, rate.beta_sigma_m) >= beta * (1 - 1e-9)
    assert found.stable
    assert found.spectral_radius <= np.exp(-beta * period / 2)
    assert found.delay_margin >= delay / period + 0.5
    loop = closed_form(equilibria_at(law.robot, elsewhere(law.robot)), law.gains)
    for late in (0.0, 0.2, 0.4, 0.5):
        assert loop.radii(period, delay + late * period).max() <= np.exp(-beta * period / 2) + BETWEEN
    assert law.rate(elsewhere(law.robot)).beta >= 0.9 * beta


@pytest.mark.parametrize("name", ["chain", pytest.param("arm7", marks=pytest.mark.full)])
def test_margins_hold_at_configurations_outside_the_check(name: str) -> None:
    """The gains are for one configuration (of arm7: for a workspace), and the check uses a larger, different set."""
    arm = robot(name)
    given = HOME + np.random.default_rng(0).uniform(-0.4, 0.4, (40, 7)) if name == "arm7" else [np.zeros(arm.n)]
    law = fjr.TrackingLaw(arm, synthesize(arm, 6.0, 1e-3, configurations=given))
    found, loop = check(law, 1e-3), closed_form(equilibria_at(arm, elsewhere(arm)), law.gains)
    assert found.configurations >= 1000
    assert found.lowest_stable_rate is not None
    assert loop.radii(1e-3).max() == pytest.approx(found.spectral_radius, abs=BETWEEN)
    assert loop.radii(1e-3, 0.93 * found.delay_margin * 1e-3).max() < 1
    assert loop.radii(1 / (1.05 * found.lowest_stable_rate)).max() < 1
    assert loop.radii(1e-3, 1.1 * found.delay_margin * 1e-3).max() > 1
    assert loop.radii(1 / (0.95 * found.lowest_stable_rate)).max() > 1


def test_gains_for_a_workspace_reach_a_higher_rate() -> None:
    """M_l varies less while the elbow is bent."""
    arm, bent = robot("planar"), np.random.default_rng(0).uniform([-1.0, 1.2], [1.0, 2.0], (40, 2))
    law = fjr.TrackingLaw(arm, synthesize(arm, 35.0, 5e-3, configurations=bent))
    assert law.rate(bent).beta >= 35 * (1 - 1e-9)
    assert check(law, 5e-3, configurations=bent, lowest_rate=False).delay_margin >= 0.5
    with pytest.raises(fjr.GainsError, match="out of reach"):
        synthesize(arm, 35.0, 5e-3)


@pytest.mark.parametrize(("name", "beta"), [("paper", 500.0), ("planar", 1e300)])
def test_rate_named_in_the_error_is_reachable(name: str, beta: float) -> None:
    given = robot(name), 0.005, 0.005
    said = refused(fjr.GainsError, lambda: synthesize(given[0], beta, *given[1:]), f"beta = {beta:g} 1/s is out of")
    assert "out of reach at 200 Hz with a delay of 0.005 s" in said
    (reached,) = (float(number) for number in re.findall(r"at most ([\d.]+) 1/s", said))
    assert fjr.TrackingLaw(given[0], synthesize(given[0], 0.99 * reached, *given[1:])).rate().beta >= 0.98 * reached
    with pytest.raises(fjr.GainsError):
        synthesize(given[0], 1.2 * reached, *given[1:])


@pytest.mark.parametrize("beta", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_rates_are_refused(beta: float) -> None:
    with pytest.raises(fjr.GainsError, match=r"^beta is .*; expected a positive finite number$"):
        synthesize(robot("paper"), beta, 1e-3)


def test_gains_on_a_domain_have_the_rate_at_every_position_of_it() -> None:
    """The straight arm has more inertia than the given configurations."""
    robot = fjr.planar_two_link()
    domain = Domain(np.array([-1.0, 0.0]), np.array([1.0, 2.0]))
    given = [[0.0, 1.5], [0.5, 2.0]]
    sampled, proven = (fjr.synthesize(robot, 5.0, 1e-3, configurations=given, domain=each) for each in (None, domain))
    straight = [[0.0, 0.0]]
    assert fjr.TrackingLaw(robot, sampled).rate(straight).beta < 5.0
    assert fjr.TrackingLaw(robot, proven).rate(straight).beta >= 5.0
    assert fjr.TrackingLaw(robot, proven).proven_rate(domain, goal=1 - 1e-6).beta >= 5.0


# The spring that is too fast for a sampled loop: named with its joint, at the limit where gains stop to exist.


def one_joint(frequency: float) -> fjr.Robot:
    """Return an undamped joint whose link oscillates on its spring at this frequency [rad/s]."""
    robot = fjr.single_link()
    inertia = float(robot.M_l([0.0])[0, 0])
    stiffness, zero = frequency**2 * inertia, np.zeros((1, 1))
    return replace(robot, K=np.array([[stiffness]]), M_m=np.array([[stiffness / 90**2]]), D_l=zero, D_m=zero)


def sentence(robot: fjr.Robot, delay: float = 0.0) -> str:
    return late_spring(equilibria_at(robot, np.zeros((1, robot.n))), 1e-3, delay, ("knee", "wrist")[-robot.n :])


def test_without_delay_the_limit_is_the_nyquist_frequency() -> None:
    assert lag_limit(1e-3, 0.0) == pytest.approx(2 * np.pi * 500)
    assert lag_limit(1e-3, 1e-3) * (0.5e-3 + 1e-3) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_no_gains_exist_beyond_the_limit_and_the_joint_is_named(delay: float) -> None:
    limit = lag_limit(1e-3, delay)
    slow, fast = one_joint(0.7 * limit), one_joint(1.6 * limit)
    assert synthesize(slow, 1.0, 1e-3, delay)
    assert sentence(slow, delay) == ""
    with pytest.raises(fjr.GainsError, match="so are all rates down to .*: the spring of joint 'wrist'") as caught:
        synthesize(fast, 1.0, 1e-3, delay, joints=("wrist",))
    assert str(caught.value).endswith(sentence(fast, delay))
    assert f"oscillates at {1.6 * limit:.4g} rad/s, and beyond {limit:.4g} rad/s" in sentence(fast, delay)


def test_the_inertia_is_the_least_that_the_joint_carries_while_the_other_moves_freely() -> None:
    robot = fjr.planar_two_link([40.0, 1e7])
    where = np.column_stack([np.zeros(13), np.linspace(-3, 3, 13)])
    M_l = np.array([robot.M_l(q_l) for q_l in where])
    (a, b), (_, d) = np.moveaxis(M_l, 0, -1)
    least = np.min(d - b * b / a)  # Schur complement
    said = late_spring(equilibria_at(robot, where), 1e-3)
    assert f"the spring of joint 2 with the inertia that it carries ({least:.3g} kg m^2)" in said
    assert f"oscillates at {np.sqrt(1e7 / least):.4g} rad/s" in said


def test_a_prismatic_joint_carries_a_mass() -> None:
    assert " kg)" in sentence(replace(one_joint(5000.0), prismatic=(True,)))


def test_joints_without_coupling_have_no_gains_of_rounding() -> None:
    arm = robot("planar")
    straight, folded = (arm.M_l([0.0, q])[0, 1] for q in (0.0, np.pi))
    q = np.arccos((straight + folded) / (folded - straight))  # the coupling is linear in cos q
    where = np.array([[0.0, q + 1e-15], [0.0, q - 1e-15]])
    assert 0 < abs(np.mean([arm.M_l(each)[0, 1] for each in where])) < 1e-12
    gains = synthesize(arm, 2.0, 1e-3, configurations=where)
    assert np.count_nonzero(gains.Pi_l) == np.count_nonzero(gains.K_ld) == 2
