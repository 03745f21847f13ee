# SPDX-License-Identifier: Apache-2.0
"""`fjr check`: print rates, sampled-data stability and limits of a scenario before it runs."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.controller import safety
from fjr_core.config.law import TYPE
from fjr_core.config.parameter import options
from fjr_core.config.scenario import Scenario
from fjr_core.errors import ParameterError
from fjr_core.extensions.law_registry import law_kind
from fjr_core.files import importing as other_package
from fjr_core.files.importing import is_named
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import joined
from fjr_core.robust.law import Robust
from fjr_core.stability.sampled_loop import SampledCheck
from fjr_design.cli.preflight import (
    StartError,
    UnstableError,
    as_list,
    checked,
    checked_at,
    position_unit,
    ranges,
    refuse_coarse_steps,
    refuse_start_outside,
    refuse_unstable,
    start_outside,
)
from fjr_design.cli.rate_rows import rate_rows, rate_values, row_near_the_reference
from fjr_design.tuning.scenario_target import tuning
from fjr_design.uncertainty.drawn_loops import FACTORS, QUANTITIES, radii_with_model_errors
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.scenarios import library

EVALUATIONS = 100  # of a law in Python, whose time is measured


def check_scenario(
    scenario: str | None,
    assignments: Sequence[str],
    certificate: Path | None = None,
    seconds: float = 120.0,
    errors: Sequence[tuple[str, float]] = (),
    prove_error: bool = False,
    prove_sampled: bool = False,
    delay: float | None = None,
) -> Result:
    """Return the check of a scenario; print its warnings and why it cannot run on standard error.

    certificate: file for the proof of the rate over the joint range, which takes at most `seconds`. errors: names and
    sizes of model errors. prove_error: prove their bound for any number of joints. prove_sampled: also prove
    contraction of the sampled loop (sampled_proof). delay [samples] of this proof and of the bound of the tracking
    error, which is made for errors, for a delay alone and for prove_error.
    """
    loaded = library.load(scenario, assignments)
    asked = errors or prove_error or (delay is not None and not prove_sampled)
    bound = _error_bound(loaded, _once(errors), delay, prove_error) if asked else None
    if certificate is not None:
        prover = other_package.module("fjr_proofs.kept_rate")
        prover.write_certificate(prover.proven_rate(loaded, seconds), certificate)
    found = checked(loaded)
    rows = check_rows(loaded, found) | ({} if bound is None else {"error bound": bound.sentence})
    proof = _sampled_proof(loaded, delay) if prove_sampled else None
    rows |= proof.rows if proof else {}
    for warning in _warnings(loaded):
        print(f"fjr: {warning}", file=sys.stderr)
    refusal = _refusal(loaded, found)
    if refusal:
        print(f"fjr: {refusal}", file=sys.stderr)
    values = _values(loaded, found, rows, refusal) | ({} if bound is None else {"error_bound": bound.values})
    values |= {"sampled_proof": proof.values} if proof else {}
    failed = refusal or (proof and not proof.found)
    return Result(table(rows), values, Exit.FAILED if failed else Exit.DONE)


def _error_bound(scenario: Scenario, errors: Mapping[str, float], delay: float | None, prove: bool) -> Any:
    """Return the bound of the tracking error; raise MissingPackageError without the package of the proofs."""
    return other_package.module("fjr_proofs.check_rows").errors_bounded(scenario, errors, delay, prove or None)


def _sampled_proof(scenario: Scenario, delay: float | None) -> Any:
    """Return the proof of the sampled loop; raise MissingPackageError without the package of the proofs."""
    return other_package.module("fjr_proofs.check_rows").sampled_proof(scenario, delay)


def _once(errors: Sequence[tuple[str, float]]) -> dict[str, float]:
    """Return the errors by name; raise ParameterError for one that is given twice."""
    for name, count in Counter(name for name, _ in errors).items():
        if count > 1:
            raise ParameterError(f"error '{name}' is given {count} times; expected it once")
    return dict(errors)


def _warnings(scenario: Scenario) -> list[str]:
    return [*scenario.warnings, *scenario.motion_warnings, *scenario.robot_warnings]


def _refusal(scenario: Scenario, found: SampledCheck) -> str:
    """Return why the scenario cannot run; empty if it can."""
    try:
        refuse_coarse_steps(scenario)
        refuse_unstable(scenario, found)
        refuse_start_outside(scenario)
    except (UnstableError, StartError) as error:
        return str(error)
    return ""


def _values(scenario: Scenario, found: SampledCheck, rows: Mapping[str, str], refusal: str) -> dict[str, Any]:
    """Return the numbers of a check, and its rows as printed."""
    return {
        "scenario": scenario.name,
        "stable": found.stable,
        "spectral_radius": found.spectral_radius,
        "delay_margin_samples": found.delay_margin,
        "lowest_stable_rate_hz": found.lowest_stable_rate,
        "sample_period_s": found.sample_period,
        **rate_values(scenario),
        "warnings": _warnings(scenario),
        "refused": refusal or None,
        "rows": {name.strip(): text for name, text in rows.items()},
    }


def table(rows: Mapping[str, str]) -> str:
    """Return the results of a check, one quantity a line."""
    width = max(len(name) for name in rows)
    return "\n".join(f"{name.ljust(width)}  {text}" for name, text in rows.items())


def check_rows(scenario: Scenario, found: SampledCheck) -> dict[str, str]:
    """Return the results of a check as text by quantity."""
    lowest = "none" if found.lowest_stable_rate is None else f"{found.lowest_stable_rate:.4g} Hz"
    return {
        "scenario": f"{scenario.name}: {', '.join(scenario.joints)}; {1 / found.sample_period:g} Hz",
        **_in_the_loop(scenario),
        **_decay(scenario),
        "spectral radius": f"{found.spectral_radius:.6f}, the worst of {_count(found)}",
        "    found at q_l": f"{as_list(found.configuration)} {position_unit(scenario)}",
        "delay margin": f"{found.delay_margin:.2f} samples ({1e3 * found.delay_margin * found.sample_period:.3g} ms)",
        "lowest stable rate": lowest,
        **_elsewhere(scenario),
        **_model_errors(scenario, found),
        **_limits(scenario),
        **_start(scenario),
        "as sampled": "stable" if found.stable else "UNSTABLE",
    }


def _decay(scenario: Scenario) -> dict[str, str]:
    """Return the rates of v-dPBC, or name and gains of another law."""
    if not isinstance(scenario.law, TrackingLaw):
        return _other_law(scenario)
    return rate_rows(scenario, scenario.law)


def _other_law(scenario: Scenario) -> dict[str, str]:
    """Return name and tuning of a law other than v-dPBC."""
    values = scenario.controller_values
    kind = law_kind(str(values["law.type"]))
    rows = {"law": f"{kind.name}: {kind.title} ({kind.paper})"}
    if is_named(kind.name):
        given = ", ".join(f"{name} {value}" for name, value in options(TYPE, values).items())
        rows["options"] = given or "none"
    elif values["law.tuned"]:
        found = tuning(values)
        rows["tuned"] = (
            f"natural frequency {found.omega:.4g} rad/s, damping ratio {found.damping:.3g}: bandwidth "
            f"{found.bandwidth:.4g} rad/s, peak effort {found.peak:.4g}; {found.sentence}"
        )
    if scenario.law.in_python:
        rows["evaluated"] = f"in Python, {1e6 * _evaluation_time(scenario):.0f} us a sample"
    return {**rows, "certificate": "none for this law"}


def _evaluation_time(scenario: Scenario) -> float:
    """Return the median time [s] that one evaluation of the law takes here."""
    n = scenario.robot.n
    at = scenario.x0[: 2 * n], np.zeros(2 * n), scenario.reference.jets(0.0)
    times = []
    for _ in range(EVALUATIONS):
        begin = time.perf_counter()
        scenario.law.measured_command(*at)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def _elsewhere(scenario: Scenario) -> dict[str, str]:
    """Return the check on the configurations that `checked` leaves out: the reference, or the whole range."""
    if isinstance(scenario.law, TrackingLaw):
        where = scenario.configurations()
        found = checked_at(scenario, where)
        beta = f"beta {scenario.law.rate(where).beta:.4g} 1/s (minimum over {len(where)} points of it)"
        margin = f"delay margin {found.delay_margin:.2f} samples"
        row = {"on the reference": f"{beta}, spectral radius {found.spectral_radius:.6f}, {margin}"}
        return {**row, **row_near_the_reference(scenario, scenario.law)}
    found = checked_at(scenario, None)
    return {"in the whole range": f"spectral radius {found.spectral_radius:.6f}, the worst of {_count(found)}"}


def _in_the_loop(scenario: Scenario) -> dict[str, str]:
    """List the parts that are checked in addition to plant, law and hold; return no row if there are none."""
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
    """Return spectral radii for errors of stiffness and inertia, a row for each, and the largest."""
    law, plant, sensing = scenario.sampled_law, scenario.plant, scenario.sensing
    radii = radii_with_model_errors(law, found.sample_period, found.delay, found.closely, plant, sensing)
    rows = {
        f"    {quantity}": ", ".join(f"{radii[quantity, factor]:.6f} at {_percent(factor)}" for factor in FACTORS)
        for quantity in QUANTITIES
    }
    (quantity, factor), worst = max(radii.items(), key=lambda item: item[1])
    state = "stable" if worst < 1 else "UNSTABLE"
    return {"with model errors": f"{state}; the worst is {quantity} {_percent(factor)}: {worst:.6f}", **rows}


def _start(scenario: Scenario) -> dict[str, str]:
    """Compare the initial position with the ranges; no row if there are none."""
    settings = safety(scenario.controller_values, scenario.robot)
    if not any(np.isfinite(limit).any() for pair in ranges(settings).values() for limit in pair):
        return {}
    found = start_outside(scenario)
    return {"initial position": f"BEYOND {'; '.join(found)}" if found else "within the ranges of the joints"}


def _limits(scenario: Scenario) -> dict[str, str]:
    """Compare the reference and the first effort with the limits of the joints; no row if there are none."""
    limits, reference = scenario.robot.limits, scenario.reference
    if limits is None:
        return {}
    reach = reference.motion_bounds(0.0, np.inf)
    outside = (reach.lower[0] < limits.lower) | (reach.upper[0] > limits.upper)
    too_fast = np.maximum(reach.upper[1], -reach.lower[1]) > limits.velocity
    law = scenario.law
    if isinstance(law, TrackingLaw):
        law = TrackingLaw(scenario.robot, scenario.gains)  # not compiled, for a single call
    position, velocity = scenario.x0[: 2 * law.robot.n], np.concatenate(scenario.plant.robot.velocities(scenario.x0))
    within, unit = _within(scenario, "position limits", outside), joined(each.effort for each in scenario.robot.units)
    first = np.abs(law.measured_command(position, velocity, reference.jets(0.0))[0])
    return {
        "reference": f"{within}; {_within(scenario, 'velocity limits', too_fast)}",
        "first effort": f"{as_list(first)} {unit}; {_within(scenario, 'effort limits', first > limits.effort)}",
    }


def _within(scenario: Scenario, what: str, broken: NDArray[np.bool_]) -> str:
    names = [joint for joint, bad in zip(scenario.joints, broken, strict=True) if bad]
    return f"within the {what}" if not names else f"BEYOND the {what} of {', '.join(names)}"


def _percent(factor: float) -> str:
    return f"{100 * (factor - 1):+.0f} %"


def _count(found: SampledCheck) -> str:
    return f"{found.configurations} configurations" if found.configurations > 1 else "1 configuration"
