# SPDX-License-Identifier: Apache-2.0
"""What is known of a scenario before it runs: its rates, its stability as sampled, its room within the limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.builders import tuning
from fjr_core.config.safety import safety
from fjr_core.config.scenario import Scenario
from fjr_core.control.registry import law_kind
from fjr_core.control.robust import Robust
from fjr_core.control.safety_settings import Settings
from fjr_core.control.vdpbc.convergence_rate import Rate
from fjr_core.control.vdpbc.law import TrackingLaw
from fjr_core.errors import FjrError
from fjr_core.numerics.checks import Array
from fjr_core.robot.equilibrium import plant_matrices, rest_points
from fjr_core.robot.joint_units import joined
from fjr_core.stability.model_errors import FACTORS, QUANTITIES, radii_with_model_errors
from fjr_core.stability.sampled_loop import HIGHEST_RATE, SampledCheck, check

RK4_REACH = 2.7  # rad: step times frequency up to which Runge-Kutta's method of order 4 is stable


class UnstableError(FjrError):
    """A scenario whose loop is unstable at its sample rate."""


class StartError(FjrError):
    """A scenario whose robot starts outside a limit of the controller."""


def checked(scenario: Scenario) -> SampledCheck:
    """Check everything that the nodes run in lock-step: robust action, observer, sensors and the scenario's own delay.

    Another law than v-dPBC, whose gains may be for one configuration, is looked at where the links will be.
    """
    where = None if isinstance(scenario.law, TrackingLaw) else scenario.configurations()
    return _checked_at(scenario, where)


def _checked_at(scenario: Scenario, where: Array | None) -> SampledCheck:
    law, period, delay = scenario.sampled_law, scenario.sample_period, scenario.loop_delay
    return check(law, period, delay, where, scenario.plant, scenario.sensing)


def refuse_coarse_steps(scenario: Scenario) -> None:
    """Raise UnstableError in one sentence where the plant's explicit integrator cannot follow its fastest mode."""
    values, plant = scenario.plant_values, scenario.plant
    A, _ = plant_matrices(rest_points(plant.robot, scenario.configurations()))
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    steps = int(values["inner_steps"])  # type: ignore[arg-type]
    if plant.integrator == "rk4" and fastest * scenario.sample_period / steps > RK4_REACH:
        raise UnstableError(
            f"scenario {scenario.name}: inner_steps is {steps}, too few for rk4 and the plant's fastest mode of "
            f"{fastest:.4g} rad/s; expected at least {np.ceil(fastest * scenario.sample_period / RK4_REACH):.0f}"
        )


def refuse_unstable(scenario: Scenario, found: SampledCheck) -> None:
    """Raise UnstableError in one sentence where the check says unstable."""
    if found.stable:
        return
    rate = found.lowest_stable_rate
    remedy = f"stable from {rate:.4g} Hz on" if rate else f"nor is it at higher rates, up to {HIGHEST_RATE:g} Hz"
    raise UnstableError(
        f"scenario {scenario.name} is unstable as sampled at {1 / found.sample_period:g} Hz: "
        f"spectral radius {found.spectral_radius:.4g} at q_l = {_list(found.configuration)} "
        f"{_position_unit(scenario)}; expected less than 1 ({remedy}; other gains: fjr gains)"
    )


def table(scenario: Scenario, found: SampledCheck) -> str:
    """The figures of a check, one a line."""
    lowest = "none" if found.lowest_stable_rate is None else f"{found.lowest_stable_rate:.4g} Hz"
    rows = {
        "scenario": f"{scenario.name}: {', '.join(scenario.joints)}; {1 / found.sample_period:g} Hz",
        **_in_the_loop(scenario),
        **_decay(scenario),
        "spectral radius": f"{found.spectral_radius:.6f}, the worst of {_count(found)}",
        "    found at q_l": f"{_list(found.configuration)} {_position_unit(scenario)}",
        "delay margin": f"{found.delay_margin:.2f} samples ({1e3 * found.delay_margin * found.sample_period:.3g} ms)",
        "lowest stable rate": lowest,
        **_elsewhere(scenario),
        **_model_errors(scenario, found),
        **_limits(scenario),
        **_start(scenario),
        "as sampled": "stable" if found.stable else "UNSTABLE",
    }
    width = max(len(name) for name in rows)
    return "\n".join(f"{name.ljust(width)}  {text}" for name, text in rows.items())


def _decay(scenario: Scenario) -> dict[str, str]:
    """The law's rates, where it has any, or its name and gains."""
    if not isinstance(scenario.law, TrackingLaw):
        return other_law(scenario)
    rate = scenario.law.rate()
    basis = _basis(rate, scenario)
    return {
        "beta": f"{rate.beta:.4g} 1/s: V falls at least as exp(-2 beta t), {basis}",
        "beta of eq. (50)": f"{rate.beta_paper:.4g} 1/s, {basis}",
    }


def other_law(scenario: Scenario) -> dict[str, str]:
    """Which law it is instead of v-dPBC, and what the rule made of its gains."""
    values = scenario.controller_values
    kind = law_kind(str(values["law.type"]))
    rows = {"law": f"{kind.name}: {kind.title} ({kind.paper})"}
    if values["law.tuned"]:
        found = tuning(values)
        rows["tuned"] = (
            f"natural frequency {found.omega:.4g} rad/s, damping ratio {found.damping:.3g}: bandwidth "
            f"{found.bandwidth:.4g} rad/s, peak effort {found.peak:.4g}; {found.sentence}"
        )
    return {**rows, "certificate": "none for this law"}


def _basis(rate: Rate, scenario: Scenario) -> str:
    """What a rate rests on."""
    if not rate.proven:
        return "in continuous time; minimum over sampled configurations, not proven"
    if not scenario.plant_is_the_model:
        return "in continuous time; not proven here, the plant is not the law's model"
    return "in continuous time, proven for every configuration"


def _elsewhere(scenario: Scenario) -> dict[str, str]:
    """The same figures where the links will be, or where a law is not looked at first (see checked)."""
    if isinstance(scenario.law, TrackingLaw):
        return {"on the reference": _on_the_reference(scenario, scenario.law)}
    found = _checked_at(scenario, None)
    return {"in the whole range": f"spectral radius {found.spectral_radius:.6f}, the worst of {_count(found)}"}


def _on_the_reference(scenario: Scenario, law: TrackingLaw) -> str:
    """The same figures where the links will be."""
    where = scenario.configurations()
    found = _checked_at(scenario, where)
    return (
        f"beta {law.rate(where).beta:.4g} 1/s (minimum over {len(where)} points of it), "
        f"spectral radius {found.spectral_radius:.6f}, "
        f"delay margin {found.delay_margin:.2f} samples"
    )


def _in_the_loop(scenario: Scenario) -> dict[str, str]:
    """What is judged besides plant, law and hold; no row where there is nothing."""
    robust, sensing, delay = getattr(scenario.sampled_law, "robust", Robust()), scenario.sensing, scenario.loop_delay
    parts = {
        "momentum residual": robust.estimates,
        "integral action": robust.integrates,
        f"prediction over {1e3 * robust.delay:g} ms": robust.predicts,
        f"velocity observer of {sensing.bandwidth} rad/s": sensing.bandwidth is not None,
        "joint torque sensors": sensing.by_torque,
        f"delay of {1e3 * delay:g} ms (imperfections.state_delay + command_delay)": delay > 0,
    }
    named = [name for name, there in parts.items() if there]
    return {"in the loop": ", ".join(named)} if named else {}


def _model_errors(scenario: Scenario, found: SampledCheck) -> dict[str, str]:
    """Spectral radii where stiffness or inertia of the plant are off, a row for each, and the worst of all."""
    law, plant, sensing = scenario.sampled_law, scenario.plant, scenario.sensing
    radii = radii_with_model_errors(law, found.sample_period, found.delay, found.closely, plant, sensing)
    rows = {
        f"    {quantity}": ", ".join(f"{radii[quantity, factor]:.6f} at {_percent(factor)}" for factor in FACTORS)
        for quantity in QUANTITIES
    }
    (quantity, factor), worst = max(radii.items(), key=lambda item: item[1])
    state = "stable" if worst < 1 else "UNSTABLE"
    return {"with model errors": f"{state}; the worst is {quantity} {_percent(factor)}: {worst:.6f}", **rows}


def _percent(factor: float) -> str:
    return f"{100 * (factor - 1):+.0f} %"


def refuse_start_outside(scenario: Scenario) -> None:
    """Raise StartError in one sentence where the plant starts outside a range that the controller stops at."""
    found = _outside(scenario)
    if found:
        raise StartError(
            f"scenario {scenario.name} starts outside a limit, where the controller stops: {'; '.join(found)}"
        )


def _start(scenario: Scenario) -> dict[str, str]:
    """The initial position against the ranges that hold; no row where there are none."""
    settings = safety(scenario.controller_values, scenario.robot)
    if not any(np.isfinite(limit).any() for pair in _ranges(settings).values() for limit in pair):
        return {}
    found = _outside(scenario)
    return {"initial position": f"BEYOND {'; '.join(found)}" if found else "within the ranges of the joints"}


def _ranges(settings: Settings) -> dict[str, tuple[Array, Array]]:
    """Lower and upper limit (n,) [rad, m] of what a start has, by its symbol."""
    deflection = np.asarray(settings.deflection)
    return {
        "q_l": (np.asarray(settings.link_position_lower), np.asarray(settings.link_position_upper)),
        "q_m": (np.asarray(settings.motor_position_lower), np.asarray(settings.motor_position_upper)),
        "q_m - q_l": (-deflection, deflection),
    }


def _outside(scenario: Scenario) -> list[str]:
    """What of the initial position is outside, joint by joint."""
    q_l, q_m = np.split(scenario.x0[: 2 * scenario.robot.n], 2)
    values = {"q_l": q_l, "q_m": q_m, "q_m - q_l": q_m - q_l}
    ranges = _ranges(safety(scenario.controller_values, scenario.robot))
    return [
        f"{joint}: {symbol} is {value:.4g} {unit.position}; expected {low:.4g} to {high:.4g} {unit.position}"
        for symbol, limits in ranges.items()
        for joint, unit, value, low, high in zip(
            scenario.joints, scenario.robot.units, values[symbol], *limits, strict=True
        )
        if not low <= value <= high
    ]


def _count(found: SampledCheck) -> str:
    return f"{found.configurations} configurations" if found.configurations > 1 else "1 configuration"


def _limits(scenario: Scenario) -> dict[str, str]:
    """The reference and the first effort against the limits of the joints, where there are any."""
    limits, reference = scenario.robot.limits, scenario.reference
    if limits is None:
        return {}
    reach = reference.extremes(0.0, np.inf)
    outside = (reach.lower[0] < limits.lower) | (reach.upper[0] > limits.upper)
    too_fast = np.maximum(reach.upper[1], -reach.lower[1]) > limits.velocity
    law = scenario.law
    if isinstance(law, TrackingLaw):
        law = TrackingLaw(scenario.robot, scenario.gains)  # for one call nothing is compiled
    position, velocity = scenario.x0[: 2 * law.robot.n], np.concatenate(scenario.plant.robot.velocities(scenario.x0))
    first = np.abs(law.measured_command(position, velocity, reference.jets(0.0))[0])
    return {
        "reference": _within(scenario, "position limits", outside)
        + "; "
        + _within(scenario, "velocity limits", too_fast),
        "first effort": f"{_list(first)} {joined(each.effort for each in scenario.robot.units)}; "
        + _within(scenario, "effort limits", first > limits.effort),
    }


def _within(scenario: Scenario, what: str, broken: NDArray[np.bool_]) -> str:
    names = [joint for joint, bad in zip(scenario.joints, broken, strict=True) if bad]
    return f"within the {what}" if not names else f"BEYOND the {what} of {', '.join(names)}"


def _position_unit(scenario: Scenario) -> str:
    return joined(each.position for each in scenario.robot.units)


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{value:.3g}" for value in values) + "]"
