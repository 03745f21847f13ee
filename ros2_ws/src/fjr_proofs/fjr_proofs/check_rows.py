# SPDX-License-Identifier: Apache-2.0
"""What `fjr check` says of the sampled loop of a scenario: the bound of its tracking error, and that it contracts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.config.controller import effort_limits
from fjr_core.config.robot import stated_errors
from fjr_core.config.scenario import Scenario, left_out
from fjr_core.errors import FjrError, ParameterError
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.joints import joined
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least, at_most
from fjr_core.robust.law import Robust, RobustLaw
from fjr_core.simulation.deviations import DEVIATIONS
from fjr_design.cli.check import Check
from fjr_msgs_py.console.output import percent, progress_bar

from .error_bound.contraction import SampledContraction, sampled_contraction
from .error_bound.drawn_robots import CONFIDENCE, ROBOTS, SHARE, DrawnRobots, drawn_robots
from .error_bound.search import DELAY, SECONDS_TO_PROVE, TORQUES, ErrorBound, bound_errors

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}|"
COVERED = tuple(f"imperfections.{name}" for name in ("state_delay", "command_delay", "payload_position", "seed"))
"""Imperfections of the plant that a proof of the sampled loop takes into account, or that change nothing."""
STATED = "stated"
"""Error that stands for the stated errors of the robot, as a number of their standard deviations."""


def errors_bounded(
    scenario: Scenario,
    errors: Mapping[str, ArrayLike],
    delay: float | None,
    prove: bool | None = None,
    seconds: float = np.inf,
) -> Check:
    """Return the bound for model errors and a delay [samples], by default that of the scenario.

    A bound that is not proven is followed by the errors of drawn robots, if all errors are those of parameters.
    errors: as of `bound_errors`, and STATED. prove, seconds: see `bound_errors`. Raises ParameterError for an unknown
    error, and for a scenario that the bound does not cover.
    """
    reasons = {
        "robust.* is enabled": isinstance(scenario.sampled_law, RobustLaw),
        "the law is evaluated in Python": scenario.law.in_python,
        "velocities or motor positions are estimated": not scenario.sensing.plain,
        "the plant is not the law's model": not scenario.plant_is_the_model,
    }
    for reason, given in reasons.items():
        if given:
            raise ParameterError(
                f"{reason}; expected a static law with all states measured for a bound of the tracking error, and the "
                "difference from the model as an error"
            )
    late = scenario.loop_delay if delay is None else delay * scenario.sample_period
    errors, place = _with_stated(scenario, errors), payload_position(scenario)
    loop = scenario.law, scenario.reference, scenario.sample_period, late, errors
    with progress_bar("bounding the tracking error", PROGRESS, total=1.0, desc="error bound") as bar:
        bound = bound_errors(*loop, lambda share: bar.update(share - bar.n), prove, place, seconds)
    tried = prove or scenario.robot.n <= SECONDS_TO_PROVE
    hint = "no proof was found" if tried else "--prove-error tries a proof"
    values = {
        "errors": {name: np.asarray(size).tolist() for name, size in bound.errors.items()},
        "delay_samples": bound.delay / bound.sample_period,
        "position": _by_joint(scenario, bound.position),
        "from_start": _by_joint(scenario, bound.from_start),
        "V_J": bound.storage if np.isfinite(bound.storage) else None,
        "proven": bound.proven,
        "parts": bound.parts,
    }
    rows = {"error bound": _sentence(scenario, bound, hint)}
    if errors and not bound.proven and (drawn := drawn_robots(scenario, errors, late, place)) is not None:
        found = {name: _by_joint(scenario, getattr(drawn, name)) for name in ("largest", "corner")}
        values["drawn"] = {"robots": ROBOTS, "unstable": drawn.unstable, "seconds": drawn.seconds, **found}
        rows[f"    {ROBOTS} drawn robots"] = _sampled(scenario, drawn) + _without(scenario, bound.errors)
        size = _largest(scenario, drawn.corner) if np.isfinite(drawn.corner).all() else "an unstable loop"
        rows["    worst corner found"] = f"{size}, of robots with every parameter at an end of its error"
    return Check(rows, values)


def _sampled(scenario: Scenario, drawn: DrawnRobots) -> str:
    """Return the errors of drawn robots in words."""
    if drawn.unstable:
        return f"{drawn.unstable} with an unstable loop, of robots whose parameters are uniform within these errors"
    return (
        f"|q_l - q_ld| at most {_largest(scenario, drawn.largest)} at the samples of {drawn.seconds:.3g} s from a "
        f"start on the reference; with {percent(CONFIDENCE, 0)} confidence {percent(SHARE, 0)} of the robots drawn "
        f"uniformly within these errors stay below {'either alone' if len({*scenario.robot.units}) > 1 else 'it'}"
    )


def _largest(scenario: Scenario, position: Array) -> str:
    """Return the largest of positions (n,) [rad] with unit and joint; of an arm with both kinds, also that in m."""
    of_unit = {scenario.robot.units[j].position: j for j in np.argsort(position)}  # the last of a unit is its largest
    return " and ".join(f"{at_most(1e3 * position[j])} m{unit} ({scenario.joints[j]})" for unit, j in of_unit.items())


def _with_stated(scenario: Scenario, errors: Mapping[str, ArrayLike]) -> Mapping[str, ArrayLike]:
    """Return the errors with those of `robot.deviations` in place of STATED; the others go before.

    Friction and constant torque of a link are a torque of any time course.
    """
    if STATED not in errors:
        return errors
    found, count = stated_errors(scenario.controller_values), np.asarray(errors[STATED])
    if count.ndim:
        raise ParameterError(f"error '{STATED}' has {count.size} numbers; expected one, of standard deviations")
    names = {each.parameter: name for name, each in DEVIATIONS.items()}
    own = {names[each]: count * getattr(found, each) for each in ("link_mass", "joint_stiffness", "link_damping")}
    torque = np.max(count * (np.asarray(found.link_coulomb_friction) + found.link_torque))
    others = {name: size for name, size in errors.items() if name != STATED}
    return {**own, "link_torque": torque, **others}


def payload_position(scenario: Scenario) -> Array:
    """Return the place (3,) [m] of a payload of the plant, in the frame of the last link."""
    return np.broadcast_to(scenario.plant_values["imperfections.payload_position"], 3)


def _sentence(scenario: Scenario, bound: ErrorBound, hint: str) -> str:
    """Return the bound in words; hint: after those of a bound without a proof."""
    samples = bound.delay / bound.sample_period
    delay = f"{samples:.3g} samples of delay" if samples else "no delay"
    if np.isclose(samples, 1):
        delay = "one sample of delay"
    conditions = ", ".join([*(_error(scenario, *error) for error in bound.errors.items()), delay])
    conditions += _without(scenario, bound.errors)
    if not bound.found:
        return f"none found with {conditions}; expected smaller errors or more --seconds"
    basis = "proven" if bound.proven else f"from sampled constants, not proven: {hint}"
    when = "in steady motion" if bound.proven and not np.isfinite(bound.from_start).all() else "after the transient"
    storage = f", V at most {at_most(1e3 * bound.storage)} mJ" if np.isfinite(bound.storage) else ""
    largest = f"{_largest(scenario, bound.position)}{storage}"
    return f"|q_l - q_ld| at most {largest} {when} along this reference, with {conditions}; {basis}"


def _without(scenario: Scenario, errors: Mapping[str, ArrayLike] = {}) -> str:
    """Return what a statement on the sampled loop leaves out of the scenario, in words; "" for nothing."""
    payload = "imperfections.payload_mass"
    known = COVERED + (payload,) * bool(scenario.plant_values[payload] <= np.max(errors.get("payload_mass", 0.0)))
    missing = [name for name in left_out(scenario) if name.startswith("imperfections.") and name not in known]
    if np.isfinite(effort_limits(scenario.controller_values, scenario.robot)).any():
        missing.append("effort limits")
    return f", without {' and '.join(missing)}" if missing else ""


def _error(scenario: Scenario, name: str, size: ArrayLike) -> str:
    if name == DELAY:
        return f"a delay that changes by up to {float(np.asarray(size)):g} samples either way"
    unit, place = DEVIATIONS[name].unit, payload_position(scenario)
    sizes = " and ".join(dict.fromkeys(f"{value if unit else 100 * value:g}" for value in np.atleast_1d(size)))
    if name in TORQUES:
        return f"{DEVIATIONS[name].of} of up to {sizes} {joined(each.effort for each in scenario.robot.units)}"
    if name == "payload_mass":
        at = f"({place[0]:g}, {place[1]:g}, {place[2]:g}) m of the last link"
        lever = "" if place.any() else ", on the axis of its joint (imperfections.payload_position)"
        return f"a payload of up to {sizes} kg at {at}{lever}"
    amount = "one common factor of up to" if name == "payload" else "up to"
    return f"{DEVIATIONS[name].of} off by {amount} {sizes} {unit or '%'}"


def _by_joint(scenario: Scenario, sizes: Array) -> dict[str, float | None]:
    """Return the bounds of each joint; null without a bound."""
    finite = np.isfinite(sizes).all()
    return {joint: float(size) if finite else None for joint, size in zip(scenario.joints, sizes, strict=True)}


def sampled_proof(scenario: Scenario, delay: float | None) -> Check:
    """Prove contraction of the loop of a scenario with all delays up to `delay` samples; None: with its own delay."""
    constant = scenario.loop_delay / scenario.sample_period
    delays = (constant, constant) if delay is None else (0.0, delay)
    try:
        found, reason = _contraction(scenario, delays), f"no tube found about the reference, {_delays(*delays)}"
    except FjrError as error:
        found, reason = None, str(error)
    if found is None:
        return Check({"sampled loop": f"NOT proven: {reason}"}, {"proven": False, "reason": reason}, failed=True)
    unit = " or m".join(dict.fromkeys(joint.position for joint in scenario.robot.units))
    tube, offset = 1e3 * float(found.tube.min()), 1e3 * float(found.offset.max())
    decay = f"contracts at {at_least(found.rate)} 1/s within {at_least(tube)} m{unit} of the reference"
    rows = {
        "sampled loop, proven": f"{decay}, {_delays(found.least_delay, found.longest_delay)}{_without(scenario)}",
        "    remaining error": f"at most {at_most(offset, 2)} m{unit} of a link",
    }
    values = {
        "proven": True,
        "rate": found.rate,
        "tube": found.tube.tolist(),
        "offset": found.offset.tolist(),
        "delay_samples": [found.least_delay, found.longest_delay],
        "sample_period_s": found.sample_period,
    }
    return Check(rows, values)


def _contraction(scenario: Scenario, delays: tuple[float, float]) -> SampledContraction | None:
    """Return the contraction with delays from .. to [samples]; raise FjrError for a loop that it does not cover."""
    robust, law = getattr(scenario.sampled_law, "robust", Robust()), scenario.law
    if not isinstance(law, TrackingLaw):
        raise ParameterError(f"law.type is {scenario.controller_values['law.type']}; expected v_dpbc")
    if robust.estimates or robust.integrates or robust.predicts:
        raise ParameterError("robust.* gives the law a state; expected a law without one")
    if not scenario.sensing.plain:
        raise ParameterError("measurement.* adds an observer or torque sensors; expected measured states")
    if not scenario.plant_is_the_model:
        raise ParameterError("plant and law have different robots; expected equal ones")
    with progress_bar("proving contraction of the sampled loop", PROGRESS, total=1.0, desc="proof") as bar:
        loop = law, scenario.reference, scenario.sample_period, delays
        return sampled_contraction(*loop, lambda share: bar.update(share - bar.n))


def _delays(least: float, longest: float) -> str:
    """Return delays [samples] in words."""
    if not longest:
        return "without delay"
    return f"delay {'up to' if least < longest else 'of'} {longest:g} sample{'' if longest == 1 else 's'}"
