# SPDX-License-Identifier: Apache-2.0
"""`fjr check`: print rates, sampled-data stability and limits of a scenario before it runs."""

from __future__ import annotations

import timeit
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.controller import effort_limits, motion_limits
from fjr_core.config.law import TYPE
from fjr_core.config.parameter import options
from fjr_core.config.scenario import Scenario
from fjr_core.errors import ParameterError
from fjr_core.extensions.law_registry import law_kind
from fjr_core.files import importing
from fjr_core.files.importing import is_named
from fjr_core.law.linearized import equilibria_at
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.joints import joined
from fjr_core.motions.motion_limits import beyond
from fjr_core.numerics.one_line import at_least
from fjr_core.robust.options import Robust
from fjr_design.cli.preflight import as_list, checked, position_unit, ranges, refusal, start_outside
from fjr_design.stability.hard_start import HardStart, hard_start
from fjr_design.stability.sampled_loop import SampledCheck
from fjr_design.tuning.equal_bandwidth import tuning
from fjr_design.uncertainty.drawn_loops import FACTORS, QUANTITIES, radii_with_model_errors
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.console.output import Result, aligned, plural, tell
from fjr_msgs_py.scenarios import library

EVALUATIONS = 100  # of a law in Python, whose time is measured
CONTINUOUS = "in continuous time"
ModelError = float | list[float]  # largest error of a parameter, or of each joint
OTHER_PLANT = "not proven here, the plant is not the law's model"


@dataclass(frozen=True)
class Check:
    """What `fjr check` says of a scenario or of a proof: rows of text by quantity, JSON values, whether it failed."""

    rows: Mapping[str, str]
    values: Mapping[str, Any]
    failed: bool = False


def check_scenario(
    scenario: str | None,
    assignments: Sequence[str],
    certificate: Path | None = None,
    seconds: float = 120.0,
    errors: Sequence[tuple[str, ModelError]] = (),
    prove_error: bool = False,
    prove_sampled: bool = False,
    delay: float | None = None,
) -> Result:
    """Return the check of a scenario; print its warnings and why it cannot run on standard error.

    certificate: file for the proof of the rate over the joint range, which takes at most `seconds`. errors: names and
    sizes of model errors. prove_error: prove their bound for any number of joints, and divide it for at most `seconds`
    for one from the start. prove_sampled: also prove contraction of the sampled loop (sampled_proof). delay [samples]
    of this proof and of the bound of the tracking error, which is made for errors, for a delay alone and for
    prove_error. Raises MissingPackageError for a proof without the package of the proofs.
    """
    loaded = library.load(scenario, assignments)
    proofs: dict[str, Check] = {}
    if errors or prove_error or (delay is not None and not prove_sampled):
        bounds = importing.module("fjr_proofs.check_rows")
        proofs["error_bound"] = bounds.errors_bounded(loaded, _once(errors), delay, prove_error or None, seconds)
    if certificate is not None:
        prover = importing.module("fjr_proofs.kept_rate")
        prover.write_certificate(prover.certified_rate(loaded, seconds), certificate)
    found = check(loaded)
    if prove_sampled:
        proofs["sampled_proof"] = importing.module("fjr_proofs.check_rows").sampled_proof(loaded, delay)
    for sentence in filter(None, [*found.values["warnings"], found.values["refused"]]):
        tell(sentence)
    rows = [row for each in (found, *proofs.values()) for row in each.rows.items()]
    values = {**found.values, "rows": {name.strip(): text for name, text in rows}}
    values |= {name: proof.values for name, proof in proofs.items()}
    failed = any(each.failed for each in (found, *proofs.values()))
    return Result("\n".join(aligned(rows)), values, Exit.FAILED if failed else Exit.DONE)


def _once(errors: Sequence[tuple[str, ModelError]]) -> dict[str, ModelError]:
    """Return the errors by name; raise ParameterError for one that is given twice."""
    for name, count in Counter(name for name, _ in errors).items():
        if count > 1:
            raise ParameterError(f"error '{name}' is given {count} times; expected it once")
    return dict(errors)


def check(scenario: Scenario) -> Check:
    """Check the loop of a scenario: its rate, stability as sampled, margins, limits and initial position."""
    found, law = checked(scenario), scenario.law
    rates, numbers = _rates(scenario, law) if isinstance(law, TrackingLaw) else (_other_law(scenario), {})
    lowest, at = found.lowest_stable_rate, as_list(found.configuration)
    start = hard_start(scenario)
    start_error = _start_error(scenario, start) if start else ""
    faults = [start_error] if start and start.diverges else []
    time = 1e6 * _evaluation_time(scenario) if scenario.law.in_python else 0.0
    period = 1e6 * found.sample_period
    faults += [f"the law takes {time:.0f} us; expected less than a sample of {period:.0f} us"] if time > period else []
    faults = [f"scenario {scenario.name}: {fault}" for fault in faults]
    rows = {
        "scenario": f"{scenario.name}: {', '.join(scenario.joints)}; {1 / found.sample_period:g} Hz",
        **_in_the_loop(scenario),
        **rates,
        **({"evaluated": f"in Python, {time:.0f} us a sample"} if time else {}),
        **_springs(scenario),
        **({"start error": start_error} if start_error else {}),
        "spectral radius": f"{found.spectral_radius:.6f}, the worst of {plural(found.configurations, 'configuration')}",
        "    found at q_l": f"{at} {position_unit(scenario)}",
        "delay margin": f"{found.delay_margin:.2f} samples ({1e3 * found.delay_margin * found.sample_period:.3g} ms)",
        "lowest stable rate": "none" if lowest is None else f"{lowest:.4g} Hz",
        **_elsewhere(scenario),
        **_model_errors(scenario, found),
        **_limits(scenario),
        **_start(scenario),
        "as sampled": "stable" if found.stable else "UNSTABLE",
    }
    faults += [f"weight {rows['weight']}: the arm cannot hold it"] if "BEYOND" in rows.get("weight", "") else []
    values = {
        "scenario": scenario.name,
        "stable": found.stable,
        "spectral_radius": found.spectral_radius,
        "delay_margin_samples": found.delay_margin,
        "lowest_stable_rate_hz": lowest,
        "sample_period_s": found.sample_period,
        **{"beta_per_s": None, "beta_is_proven": False, "beta_attained_per_s": None, **numbers},
        "warnings": [*scenario.warnings, *scenario.motion_warnings, *scenario.robot_warnings, *faults],
        "refused": refusal(scenario, found) or None,
    }
    return Check(rows, values, failed=values["refused"] is not None)


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


def _rates(scenario: Scenario, law: TrackingLaw) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the rows of beta and of the beta of eq. (50), and their numbers as JSON values.

    Proven: by a closed form, or by branch and bound in an earlier command, which has kept its CertifiedRate. Then the
    configuration that attains the smallest rate has a row, too. Otherwise the rate is a minimum over samples.
    """
    rate, exact, kept = law.rate(), scenario.plant_is_the_model, None
    if scenario.robot.links.M_l_vertices is None and _is_provable(scenario):
        kept = importing.module("fjr_proofs.kept_rate").cached_rate(scenario)
    more = {}
    if kept is not None:
        basis = f"proven over the joint range{'' if kept.complete else ' so far'}" if exact else OTHER_PLANT
        basis = f"{CONTINUOUS}{',' if exact else ';'} {basis}"
        sampled = "" if kept.complete else f"; minimum over sampled configurations: {rate.beta:.4g} 1/s"
        at = f"{as_list(np.array(kept.at))} {position_unit(scenario)}"
        more = {"    rate at q_l": f"{at}: {kept.attained:.4g} 1/s{sampled}"}
    elif not rate.proven:
        basis = f"{CONTINUOUS}; minimum over sampled configurations, not proven"
    else:
        basis = f"{CONTINUOUS} for the exact model, proven for every configuration"
        basis = basis if exact else f"{CONTINUOUS}; {OTHER_PLANT}"
    found = kept or rate
    rows = {
        "beta": f"{at_least(found.beta)} 1/s: V falls at least as exp(-2 beta t), {basis}",
        "beta of eq. (50)": f"{at_least(found.beta_paper)} 1/s, {basis}",
        **more,
    }
    proven = exact and (rate.proven or kept is not None)
    return rows, {"beta_per_s": found.beta, "beta_is_proven": proven, "beta_attained_per_s": kept and kept.attained}


def _springs(scenario: Scenario) -> dict[str, str]:
    """Return how much stiffer or softer than joint_stiffness springs with a curve are at rest, else no row."""
    robot = scenario.plant.robot
    if not robot.curve:
        return {}
    more = 100 * (equilibria_at(robot, scenario.configurations()).hardening - 1)
    softer = f"up to {as_list(-more.min(axis=0))} % softer, " if more.min() < 0 else ""
    seen = f"{softer}up to {as_list(more.max(axis=0))} % stiffer at rest on the reference"
    return {"springs": f"{seen}; radii are of springs under the weight"}


def _start_error(scenario: Scenario, start: HardStart) -> str:
    """Return how far the start deflects springs that harden, and whether the loop is stable with such stiff ones."""
    unit = position_unit(scenario)
    inside = f"{as_list(start.inside * start.error)}, {100 * start.inside:.0f} % of it"
    if start.diverges:
        return (
            f"the loop diverges as sampled from the start error {as_list(start.error)} {unit}, which deflects springs "
            f"that harden too far; expected at most {inside}"
        )
    seen = f"springs deflect up to {as_list(start.deflection)} {unit}"
    stiff = f"spectral radius {start.radius:.6f} with springs as stiff as there"
    if start.radius < 1:
        return f"{seen}; {stiff}"
    return f"{seen}; the simulated motion returns, but {stiff}; below 1 up to {inside}"


def _is_provable(scenario: Scenario) -> bool:
    """Return whether something can be proven about the robot: the package of the proofs is there and covers it."""
    bounds = importing.module_if_there("fjr_proofs.verification.inertia_bounds")
    return bounds is not None and bool(bounds.is_provable(scenario.robot))


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
    return {**rows, "certificate": "none for this law"}


def _evaluation_time(scenario: Scenario) -> float:
    """Return the median time [s] that an evaluation of the law takes."""
    n, jets = scenario.robot.n, scenario.reference.jets(0.0)
    evaluate = partial(scenario.law.measured_command, scenario.x0[: 2 * n], np.zeros(2 * n), jets)
    return float(np.median(timeit.repeat(evaluate, number=1, repeat=EVALUATIONS)))


def _elsewhere(scenario: Scenario) -> dict[str, str]:
    """Return the check on the configurations that `checked` leaves out: the reference, or the whole range.

    For v-dPBC also the rate that is proven within a radius of the reference, if something can be proven.
    """
    law, found = scenario.law, checked(scenario, elsewhere=True, lowest_rate=False)
    if not isinstance(law, TrackingLaw):
        count = plural(found.configurations, "configuration")
        return {"in the whole range": f"spectral radius {found.spectral_radius:.6f}, the worst of {count}"}
    where = scenario.configurations()
    beta = f"beta {law.rate(where).beta:.4g} 1/s (minimum over {len(where)} points of it)"
    margin = f"delay margin {found.delay_margin:.2f} samples"
    rows = {"on the reference": f"{beta}, spectral radius {found.spectral_radius:.6f}, {margin}"}
    if _is_provable(scenario):
        bounds = importing.module("fjr_proofs.verification.inertia_bounds")
        domain, radius = importing.module("fjr_proofs.kept_rate").near_reference(scenario)
        rate = law.proven_rate(domain, most_boxes=bounds.few_boxes(scenario.robot))
        low, high = np.min(radius), np.max(radius)
        within = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        near = f"within {within} {position_unit(scenario)} of the reference in each joint"
        basis = "proven" if scenario.plant_is_the_model else OTHER_PLANT
        rows["near the reference"] = f"beta {at_least(rate.beta)} 1/s {near}, {basis}"
    return rows


def _model_errors(scenario: Scenario, found: SampledCheck) -> dict[str, str]:
    """Return spectral radii for errors of stiffness and inertia, a row for each, and the largest."""
    law, plant, sensing = scenario.sampled_law, scenario.plant, scenario.sensing
    radii = radii_with_model_errors(law, found.sample_period, found.delay, found.closely, plant, sensing)
    percent = {factor: f"{100 * (factor - 1):+.0f} %" for factor in FACTORS}
    rows = {
        f"    {quantity.replace('_', ' ')}": ", ".join(
            f"{radii[quantity, factor]:.6f} at {percent[factor]}" for factor in FACTORS
        )
        for quantity in QUANTITIES
    }
    (quantity, factor), worst = max(radii.items(), key=lambda item: item[1])
    state = "stable" if worst < 1 else "UNSTABLE"
    return {
        "with model errors": f"{state}; the worst is {quantity.replace('_', ' ')} {percent[factor]}: {worst:.6f}",
        **rows,
    }


def _limits(scenario: Scenario) -> dict[str, str]:
    """Compare reference, first effort and weight with the tighter limits of robot and controller; no row for none."""
    motion, reference, robot = motion_limits(scenario.settings, scenario.robot), scenario.reference, scenario.robot
    most = effort_limits(scenario.controller_values, robot)
    if not np.isfinite([*motion.minimum, *motion.maximum, most]).any():
        return {}

    def within(what: str, broken: NDArray[np.bool_]) -> str:
        names = [joint for joint, bad in zip(scenario.joints, broken, strict=True) if bad]
        return f"within the {what} limits" if not names else f"BEYOND the {what} limits of {', '.join(names)}"

    reach = reference.motion_bounds(0.0, np.inf)
    outside = np.any(beyond(np.array([reach.lower, reach.upper]), motion), axis=0)
    law = TrackingLaw(robot, scenario.gains) if isinstance(scenario.law, TrackingLaw) else scenario.law  # not compiled
    position, velocity = scenario.x0[: 2 * robot.n], np.concatenate(scenario.plant.robot.velocities(scenario.x0))
    first = np.abs(law.measured_command(position, velocity, reference.jets(0.0))[0])
    weight = np.abs([np.linalg.solve(robot.B_m, robot.grad_P_l(q)) for q in reference.configurations(64)]).max(axis=0)
    unit = joined(each.effort for each in robot.units)
    return {
        "reference": f"{within('position', outside[0])}; {within('velocity', outside[1])}",
        "first effort": f"{as_list(first)} {unit}; {within('effort', ~(first <= most))}",
        "weight": f"up to {as_list(weight)} {unit} on the reference; {within('effort', ~(weight <= most))}",
    }


def _start(scenario: Scenario) -> dict[str, str]:
    """Compare the initial position with the ranges; no row if there are none."""
    if not any(np.isfinite(limit).any() for pair in ranges(scenario.settings).values() for limit in pair):
        return {}
    found = start_outside(scenario)
    return {"initial position": f"BEYOND {'; '.join(found)}" if found else "within the ranges of the joints"}
