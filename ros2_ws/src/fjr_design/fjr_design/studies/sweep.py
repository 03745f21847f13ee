# SPDX-License-Identifier: Apache-2.0
"""A sweep as one plain value: scenario, drawn deviations, success criterion; run any part of its runs.

It is described by a YAML file, and for its workers and its folder by JSON.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config import ros_yaml
from fjr_core.config.scenario import Scenario, left_out, parse_scenario
from fjr_core.errors import ParameterError, prefixed
from fjr_core.model.joints import joined
from fjr_core.simulation.deviations import JOINT
from fjr_core.simulation.imperfections import Imperfections, friction_rate, stuck_rate
from fjr_msgs_py.scenarios import installed, library

from ..batch import ClosedLoop, Draws, Outcomes, draws, scenario_loop
from ..batch.closed_loop import FIELDS, PER_JOINT
from ..batch.draws import FIXED, FORM, PARAMETERS, Distribution, DrawnColumn, varied
from ..batch.parametric_robot import FRICTION
from ..uncertainty.posterior import Identification, PosteriorDraws, read_identification
from .sections import Reader, between, mapping, number, section, string, subsection, whole
from .study import Columns, Study

OUTCOMES = {
    "rms": ("RMS error", "rad"),
    "peak": ("largest error", "rad"),
    "final": ("mean error of the last second", "rad"),
    "settling": ("settling time", "s"),
    "effort_rms": ("RMS effort", "N m"),
    "effort_peak": ("peak effort", "N m"),
    "effort_noise": ("noise in the effort", "N m"),
    "power": ("mean power", "W"),
}
"""Words and unit of the outcomes that a sweep summarises and that its success criterion may limit."""
MEANS, LARGEST = ("rms", "effort_rms", "effort_noise"), ("peak", "final", "effort_peak")
FIGURES = (*MEANS, *LARGEST, "power")
"""Figures of a run: root mean square over the joints, largest of the joints, of the whole arm."""
SUCCESS = "success"
Figures = Columns
MOST_RUNS = 10**9
REACH = 2.0  # largest product of friction rate and step; Runge-Kutta of order 4 is stable up to 2.78
NOISE_SEED = "seed"
TUNE = "tune"  # what `fjr tune` does with the study; `fjr sweep` ignores it
POSTERIOR = "posterior"
OF_SWEEP: Mapping[str, Reader] = {
    "success": subsection(dict.fromkeys(OUTCOMES, number)),
    "runs": between(1, MOST_RUNS, whole),
    "seed": between(0, 2**64 - 1, whole),
    **dict.fromkeys(("duration", "settle_after"), number),
    **dict.fromkeys(("band", "lost"), lambda _, value: value),  # of each joint: ClosedLoop checks them
}
KEYS: Mapping[str, Reader] = {
    "scenario": string,
    POSTERIOR: string,
    **dict.fromkeys(("vary", "set", TUNE), mapping),
    **OF_SWEEP,
}
"""Readers of the keys of a sweep file; those of OF_SWEEP have the fields of Sweep of the same name."""
RUNS = 1000


def figures(outcomes: Outcomes, success: NDArray[np.bool_]) -> Figures:
    """Return the FIGURES (k,) of k runs, and `success` (k,)."""
    found: Figures = {name: np.sqrt(np.mean(np.square(getattr(outcomes, name)), axis=1)) for name in MEANS}
    found |= {name: np.max(getattr(outcomes, name), axis=1) for name in LARGEST}
    return {**found, "power": outcomes.power, SUCCESS: success}


def refuse_what_is_left_out(scenario: Scenario, instead: str) -> None:
    """Raise ParameterError if the plant of the scenario has features that a study does not simulate.

    instead: end of the sentence, which names the alternative.
    """
    integrator = scenario.plant_values["integrator"]
    if integrator != "rk4":
        raise ParameterError(f"parameter 'integrator' is '{integrator}'; expected 'rk4', the integrator of a study")
    names = [name for name in left_out(scenario) if name.startswith("imperfections.")]
    if names:
        raise ParameterError(f"the scenario sets {', '.join(names)}; expected the default here: {instead}")


@dataclass(frozen=True)
class Sweep(Study):
    """Sweep of `runs` runs of `duration` [s] of a scenario, given as its self-contained text.

    vary: distributions or fixed values by field of Draws. posterior: plain values of an identification from which the
    plants are drawn in addition. seed: of all random numbers. settle_after [s], band, lost [rad], one number or one for
    each joint: see ClosedLoop. success: largest value of an outcome, one number or one for each joint, of a successful
    stable run. Raises ParameterError.
    """

    name: str
    scenario_text: str
    runs: int
    vary: Mapping[str, Distribution]
    duration: float = 5.0
    seed: int = 0
    settle_after: float = 1.0
    band: float | Sequence[float] | None = None
    lost: float | Sequence[float] | None = None
    success: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    posterior: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        refuse_what_is_left_out(self.scenario, "a sweep draws these itself, use 'vary'")
        for name, distribution in self.vary.items():
            self._check(name, distribution)
            if self.identified is not None and name in self.identified.columns:
                raise ParameterError(f"'vary' has '{name}', which the posterior draws; expected it in one of them")
        first = self.draws(0, 1)
        for name in PARAMETERS:
            _ = first.columns(name, self.scenario.robot.n)

    @cached_property
    def scenario(self) -> Scenario:
        """Scenario of the nominal run."""
        return parse_scenario(self.name, self.scenario_text)

    def units(self, unit: str, joint: str = "") -> str:
        """Return the unit of a joint for that of a revolute one, or the units of all joints."""
        of_joint = dict(zip(self.scenario.joints, self.scenario.robot.units, strict=True))
        return joined(each.of(unit) for each in ([of_joint[joint]] if joint in of_joint else of_joint.values()))

    @cached_property
    def loop(self) -> ClosedLoop:
        """Closed loop of all runs; the effort limit is that of the draws."""
        bounds = {"settle_after": self.settle_after, "band": self.band, "lost": self.lost}
        loop = scenario_loop(self.scenario, self.scenario.sampled_law, self.duration, **bounds)
        return replace(loop, settings=replace(self.scenario.settings, effort=np.inf))

    def refuse_stiff_friction(self) -> None:
        """Raise ParameterError if friction or hysteresis that can be drawn is too stiff for the steps of the plant."""
        ranges = {name: one.range for name, one in self.vary.items()}
        ranges |= {name: self.identified.range(name) for name in self.identified.columns} if self.identified else {}
        least, most = ({name: both[side] for name, both in ranges.items()} for side in (0, 1))
        robot, inertia = self.scenario.plant.robot, least.get("link_inertia", 1.0) * least.get("link_mass", 1.0)
        levels = {name: most[name] for name in FRICTION if name in most}
        levels |= {"hysteresis": most.get("hysteresis", 0.0), "slip": least.get("slip", PARAMETERS["slip"].nominal)}
        smoothing = least.get("smoothing", PARAMETERS["smoothing"].nominal)
        steepest = Imperfections(robot.n, **levels, smoothing=smoothing)
        M_l, M_m = inertia * robot.M_l(self.scenario.x0[: robot.n]), least.get("motor_inertia", 1.0) * robot.M_m
        rate, dt = friction_rate(steepest, M_l, M_m), self.loop.sample_period / self.loop.inner_steps
        if rate * dt > REACH:
            enough = rate * dt / REACH * smoothing
            raise ParameterError(
                f"friction may damp at {rate:.3g} 1/s, too fast for steps of {1e3 * dt:.3g} ms; "
                f"expected a smoothing of at least {enough:.2g} rad/s, or more inner_steps"
            )
        rate = stuck_rate(steepest, most.get("stiffness", 1.0) * robot.K, M_l, M_m)
        if rate * dt > REACH:
            raise ParameterError(
                f"springs with hysteresis may oscillate at {rate:.3g} rad/s, too fast for steps of {1e3 * dt:.3g} ms; "
                "expected a larger slip, or more inner_steps"
            )

    def draws(self, begin: int, end: int) -> Draws:
        """Return the draws of the runs begin .. end - 1, which depend only on the numbers of the runs."""
        n, count = self.scenario.robot.n, end - begin
        fixed: dict[str, Any] = {"effort_limit": np.tile(np.asarray(self.scenario.settings.effort), (count, 1))}
        for name, distribution in self.vary.items():
            values = distribution.drawn(name, self.seed, begin, count, n)
            fixed[name] = values[:, 0] if PARAMETERS[name].per_run else values
        if self.identified is not None:
            fixed |= self.identified.drawn(self.seed, begin, count)
        return Draws(count, **fixed, seed=draws.rows((self.seed, draws.stream(NOISE_SEED)), begin, count, 1)[:, 0])

    def part(self, begin: int, end: int) -> Columns:
        """Run begin .. end - 1; return number, draws, success and outcomes as columns by name."""
        drawn_values, joints = self.draws(begin, end), self.scenario.joints
        outcomes = self.loop.run(drawn_values)
        columns: Columns = {"run": np.arange(begin, end)}
        for each in self.drawn:
            columns[each.column] = drawn_values.columns(each.name, len(joints))[:, each.entry]
        columns[SUCCESS] = self.succeeded(outcomes)
        for name in FIELDS:
            values = getattr(outcomes, name)
            if name in PER_JOINT:
                columns |= {f"{name}.{joint}": column for joint, column in zip(joints, values.T, strict=True)}
            else:
                columns[name] = values
        return columns

    def succeeded(self, outcomes: Outcomes) -> NDArray[np.bool_]:
        """Return which runs (k,) are stable, were not stopped and are within all limits of success."""
        kept = [np.asarray(getattr(outcomes, name)) <= limit for name, limit in self.success.items()]
        each = [one.all(axis=1) if one.ndim > 1 else one for one in kept]
        return np.asarray(np.logical_and.reduce([outcomes.stable, outcomes.cause == "", *each]))

    @cached_property
    def identified(self) -> PosteriorDraws | None:
        """Draws from the posterior; raises ParameterError."""
        if self.posterior is None:
            return None
        return PosteriorDraws(Identification.from_dict(self.posterior), self.scenario.plant.robot, self.scenario.joints)

    @cached_property
    def drawn(self) -> tuple[DrawnColumn, ...]:
        """Numbers that differ between runs: one for a deviation, or one per joint."""
        found = []
        for name, one in self.vary.items():
            if one.kind != FIXED:
                each = [f"{name}.{joint}" for joint in self.scenario.joints] if one.each_joint else [name]
                found += [DrawnColumn(column, name, i, one) for i, column in enumerate(each)]
        posterior = self.identified.columns.values() if self.identified else ()
        return (*found, *(each for columns in posterior for each in columns))

    def build(self) -> None:
        """Compile the loop of all runs."""
        self.loop.build()

    @classmethod
    def from_text(cls, text: str) -> Sweep:
        """Return the sweep with this text."""
        values = json.loads(text)
        return cls(**values | {"vary": varied(values["vary"])})

    @property
    def text(self) -> str:
        """Sweep as JSON; sweeps with equal text have equal results."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        values["vary"] = {name: one.as_yaml for name, one in self.vary.items()}
        return json.dumps({name: value for name, value in values.items() if value is not None}, indent=1)

    def _check(self, name: str, one: Distribution) -> None:
        """Raise ParameterError unless every value of a distribution is one of the deviation."""
        if name not in PARAMETERS:
            raise ParameterError(f"'vary' has '{name}'; expected some of {', '.join(PARAMETERS)}")
        if one.each_joint and PARAMETERS[name].per != JOINT:
            raise ParameterError(f"'{name}' has each_joint; expected one value for all joints")
        if one.kind == FIXED:
            given, most = len(one.numbers), PARAMETERS[name].width(self.scenario.robot.n)
            if given not in (1, most):
                expected = "a single one" if most == 1 else f"1 or {most}"
                raise ParameterError(f"'vary': {name} has {given} numbers; expected {expected}")
            return
        with prefixed("'vary', for every draw: "):
            Draws(2, **{name: np.array(one.range)})


def file_of(name: str | None) -> Path:
    """Return the path of an installed sweep or scenario, given its name, or of a file."""
    sweeps = installed("sweeps")
    if name in sweeps:
        return sweeps[name]
    try:
        return library.find(name)
    except library.ScenarioError as error:
        raise library.ScenarioError(f"{error}; or of the sweeps {', '.join(sweeps)}") from None


def planned(name: str | None, assignments: Sequence[str] = (), **numbers: float | None) -> Sweep:
    """Return the sweep to run; raise FjrError. numbers: of the sweep, None keeps its own."""
    path, given = file_of(name), {key: value for key, value in numbers.items() if value is not None}
    return described(path, ros_yaml.read(path, "sweep"), library.parse_assignments(assignments), given)


def described(path: Path, document: Any, overrides: Mapping[str, Any], replaced: Mapping[str, Any]) -> Sweep:
    """Return the sweep of a parsed file, of a scenario the usual one; raise FjrError.

    overrides: parameters of the scenario. replaced: numbers of the sweep that replace those of the file.
    """
    if not is_one(document):
        text, loaded = library.as_run(path, overrides)
        return Sweep(path.stem, text, vary=usual(loaded.sample_period), **{"runs": RUNS, **replaced})
    with prefixed(f"sweep {path.stem} "):
        given = read(document)
        beside = path.parent / given["scenario"]
        scenario = beside if os.path.isfile(beside) else library.find(given["scenario"])
        text, _ = library.as_run(scenario, {**given.get("set", {}), **overrides})
        own = {key: given[key] for key in ("vary", *OF_SWEEP) if key in given}
        if given.get(POSTERIOR):
            own[POSTERIOR] = read_identification(path.parent / given[POSTERIOR]).as_dict()
        return Sweep(path.stem, text, **{"runs": RUNS, **own, **replaced})


def is_one(document: object) -> bool:
    """Return whether a YAML document is a sweep, not a scenario."""
    return isinstance(document, Mapping) and "scenario" in document and "/**" not in document


def read(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that a parsed file gives, `vary` as distributions; raise ParameterError."""
    given = section(document, KEYS)
    vary = varied(given.get("vary", {}))
    if not given.get(POSTERIOR) and not any(one.kind != FIXED for one in vary.values()):
        raise ParameterError(f"draws nothing; expected '{POSTERIOR}', or 'vary' with {FORM}")
    return {**given, "vary": vary}


def usual(sample_period: float) -> dict[str, Distribution]:
    """Return the default distributions: typical deviations of a robot from its data sheet."""
    document = {
        "stiffness": {"uniform": [0.7, 1.3], "each_joint": True},
        "link_inertia": {"uniform": [0.8, 1.2]},
        "gravity": {"uniform": [0.9, 1.1]},
        "motor_inertia": {"uniform": [0.9, 1.1], "each_joint": True},
        "link_damping": {"log_uniform": [0.5, 2.0], "each_joint": True},
        "motor_damping": {"log_uniform": [0.5, 2.0], "each_joint": True},
        "delay": {"uniform": [0.0, sample_period]},
    }
    return varied(document)
