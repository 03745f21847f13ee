# SPDX-License-Identifier: Apache-2.0
"""Check a scenario before it runs: stability as sampled, integrator steps, initial position."""

from __future__ import annotations

import numpy as np

from fjr_core.config.controller import motion_limits
from fjr_core.config.scenario import Scenario
from fjr_core.errors import FjrError, TrajectoryError
from fjr_core.law.linearized import equilibria_at
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.joints import joined
from fjr_core.motions.motion_limits import check_motion
from fjr_core.numerics.checks import Array
from fjr_core.runtime.safety_settings import Settings
from fjr_design.stability.sampled_loop import HIGHEST_RATE, SampledCheck, check, fastest_mode, late_spring, least_steps


class UnstableError(FjrError):
    """The loop of a scenario is unstable at its sample rate."""


def checked(scenario: Scenario, elsewhere: bool = False, lowest_rate: bool = True) -> SampledCheck:
    """Check the sampled loop that the nodes run in lock-step, with robust.* options, observer, sensors and delay.

    v-dPBC is checked in the whole range of the joints. Another law, whose gains may hold for one configuration only,
    is checked along the reference. elsewhere: the other way round. lowest_rate: see sampled_loop.check.
    """
    everywhere = isinstance(scenario.law, TrackingLaw) != elsewhere
    where = None if everywhere else scenario.configurations()
    law, period, delay = scenario.sampled_law, scenario.sample_period, scenario.loop_delay
    return check(law, period, delay, where, scenario.plant, scenario.sensing, lowest_rate)


def refuse_coarse_steps(scenario: Scenario) -> None:
    """Raise UnstableError if the plant's explicit integrator is unstable for its fastest mode."""
    plant, steps = scenario.plant, scenario.inner_steps
    fastest = fastest_mode(plant.robot, scenario.configurations())
    least = least_steps(fastest, scenario.sample_period)
    if plant.integrator == "rk4" and steps < least:
        raise UnstableError(
            f"scenario {scenario.name}: inner_steps is {steps}, too few for rk4 and the plant's fastest mode of "
            f"{fastest:.4g} rad/s; expected at least {least}"
        )


def refuse_unstable(scenario: Scenario, found: SampledCheck | None = None) -> None:
    """Raise UnstableError if the loop is unstable; found: its check.

    Without one the lowest stable rate, which takes most of the time, is searched only for an unstable loop.
    """
    if (found or checked(scenario, lowest_rate=False)).stable:
        return
    found = found or checked(scenario)
    what, at = f"scenario {scenario.name}", f"at q_l = {as_list(found.configuration)} {position_unit(scenario)}"
    if np.isinf(found.spectral_radius):
        raise UnstableError(
            f"{what}: the effort of the law, or its slope, is not finite {at}, at rest; expected finite numbers"
        )
    raise UnstableError(
        f"{what} is unstable as sampled at {1 / found.sample_period:g} Hz: spectral radius {found.spectral_radius:.4g} "
        f"{at}; {_remedy(scenario, found)}"
    )


def _remedy(scenario: Scenario, found: SampledCheck) -> str:
    """Return what makes an unstable loop stable; names the joint whose spring is too fast for the loop."""
    rate, points = found.lowest_stable_rate, equilibria_at(scenario.robot, found.closely)
    reason = late_spring(points, found.sample_period, found.delay, scenario.joints)
    from_rate = f"stable from {rate:.4g} Hz on" if rate else ""
    if reason:
        return f"{reason}{f' ({from_rate})' if rate else ''}, then new gains (fjr gains)"
    from_rate = from_rate or f"nor is it at higher rates, up to {HIGHEST_RATE:g} Hz"
    return f"expected less than 1 ({from_rate}; other gains: fjr gains)"


def ranges(settings: Settings) -> dict[str, tuple[Array, Array]]:
    """Return lower and upper limit (n,) [rad, m] of the initial positions, by symbol."""
    deflection = np.asarray(settings.deflection)
    return {
        "q_l": (np.asarray(settings.link_position_lower), np.asarray(settings.link_position_upper)),
        "q_m": (np.asarray(settings.motor_position_lower), np.asarray(settings.motor_position_upper)),
        "q_m - q_l": (-deflection, deflection),
    }


def start_outside(scenario: Scenario) -> list[str]:
    """Return a sentence for each initial position outside its range."""
    q_l, q_m = np.split(scenario.x0[: 2 * scenario.robot.n], 2)
    values = {"q_l": q_l, "q_m": q_m, "q_m - q_l": q_m - q_l}
    return [
        f"{joint}: {symbol} is {value:.4g} {unit.position}; expected {low:.4g} to {high:.4g} {unit.position}"
        for symbol, limits in ranges(scenario.settings).items()
        for joint, unit, value, low, high in zip(
            scenario.joints, scenario.robot.units, values[symbol], *limits, strict=True
        )
        if not low <= value <= high
    ]


def refusal(scenario: Scenario, found: SampledCheck) -> str:
    """Return why the scenario cannot run; empty if it can."""
    try:
        refuse_coarse_steps(scenario)
        refuse_unstable(scenario, found)
        check_motion(scenario.reference, motion_limits(scenario.settings, scenario.robot), joints=scenario.joints)
    except UnstableError as error:
        return str(error)
    except TrajectoryError as error:
        return f"scenario {scenario.name} has a reference beyond its limits, with which no controller starts: {error}"
    outside = "; ".join(start_outside(scenario))
    return f"scenario {scenario.name} starts outside a limit, where the controller stops: {outside}" if outside else ""


def position_unit(scenario: Scenario) -> str:
    """Return the unit of the joints' positions: rad, m, or both."""
    return joined(each.position for each in scenario.robot.units)


def as_list(values: Array) -> str:
    """Return values with three digits in brackets."""
    return "[" + ", ".join(f"{value if abs(value) > 1e-6 else 0:.3g}" for value in values) + "]"
