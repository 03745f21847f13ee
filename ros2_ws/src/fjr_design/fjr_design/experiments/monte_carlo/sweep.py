# SPDX-License-Identifier: Apache-2.0
"""Monte-Carlo study as one plain value: scenario, distributions, success criterion; run any part of it."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.controller import safety
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import ParameterError
from fjr_core.runtime.safety_settings import Settings
from fjr_core.simulation.batch import counter_rng
from fjr_core.simulation.batch.closed_loop import ClosedLoop
from fjr_core.simulation.batch.draws import LEVELS, PER_RUN, SMOOTHING, Draws, width
from fjr_core.simulation.batch.outcomes import FIELDS, PER_JOINT, Outcomes
from fjr_core.simulation.batch.uncertain_robot import FRICTION
from fjr_core.simulation.imperfections import Imperfections, friction_rate

from ...posterior.result import Identification
from ..scenario_loop import refuse_what_is_left_out, scenario_loop
from . import distributions
from .distributions import Distribution
from .posterior import Column, PosteriorDraws, column_names

MEASURES = ("rms", "peak", "final", "settling", "effort_rms", "effort_peak", "power")
"""Outcomes that the success criterion may limit."""
MOST_RUNS = 10**9
REACH = 2.0
"""Largest product of friction rate and step; Runge-Kutta of order 4 is stable up to 2.78."""
NOISE_SEED = "seed"


Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Sweep:
    """Study of `runs` runs of `duration` [s] of a scenario, given as its self-contained text.

    vary: distributions or fixed values by field of Draws. posterior: plain values of an identification from which the
    plants are drawn in addition. seed: of all random numbers. settle_after [s], band, lost
    [rad]: see ClosedLoop. success: largest value of an outcome, at every joint, of a successful stable run. Raises
    ParameterError.
    """

    name: str
    scenario_text: str
    runs: int
    vary: Mapping[str, Distribution]
    duration: float = 5.0
    seed: int = 0
    settle_after: float = 1.0
    band: float = 0.01
    lost: float = float(np.pi / 2)
    success: Mapping[str, float] = field(default_factory=dict)
    posterior: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.runs <= MOST_RUNS:
            raise ParameterError(f"'runs' is {self.runs}; expected 1 to {MOST_RUNS}")
        if not 0 <= self.seed < 2**64:
            raise ParameterError(f"'seed' is {self.seed}; expected 0 to 2^64 - 1")
        for name, limit in self.success.items():
            if name not in MEASURES:
                raise ParameterError(f"'success' has '{name}'; expected some of {', '.join(MEASURES)}")
            if np.isnan(limit):
                raise ParameterError(f"'success' has {limit} as '{name}'; expected a number")
        refuse_what_is_left_out(self.scenario, "a sweep draws these itself, use 'vary'")
        for name, distribution in self.vary.items():
            self._check(name, distribution)
            if name in self._from_posterior:
                raise ParameterError(f"'vary' has '{name}', which the posterior draws; expected it in one of them")
        first = self.draws(0, 1)
        for name in LEVELS:
            _ = first.columns(name, self.scenario.robot.n)

    @cached_property
    def scenario(self) -> Scenario:
        """Scenario of the nominal run."""
        return parse_scenario(self.name, self.scenario_text)

    @cached_property
    def loop(self) -> ClosedLoop:
        """Closed loop of all runs; the effort limit is that of the draws."""
        bounds = {"settle_after": self.settle_after, "band": self.band, "lost": self.lost}
        loop = scenario_loop(self.scenario, self.scenario.sampled_law, self.duration, **bounds)
        return replace(loop, settings=replace(self._settings, effort=np.inf))

    def refuse_stiff_friction(self) -> None:
        """Raise ParameterError if the stiffest friction that can be drawn is too stiff for the steps of the plant."""
        ranges = {name: one.range for name, one in self.vary.items()}
        ranges |= {name: self.identified.range(name) for name in self._from_posterior if self.identified}
        least, most = ({name: both[side] for name, both in ranges.items()} for side in (0, 1))
        robot, inertia = self.scenario.plant.robot, [least.get(name, 1.0) for name in ("link_inertia", "motor_inertia")]
        levels = {name: most[name] for name in FRICTION if name in most}
        steepest = Imperfections(robot.n, **levels, smoothing=least.get("smoothing", SMOOTHING))
        M_l, M_m = inertia[0] * robot.M_l(self.scenario.x0[: robot.n]), inertia[1] * robot.M_m
        rate, dt = friction_rate(steepest, M_l, M_m), self.loop.sample_period / self.loop.inner_steps
        if rate * dt > REACH:
            enough = rate * dt / REACH * least.get("smoothing", SMOOTHING)
            raise ParameterError(
                f"friction may damp at {rate:.3g} 1/s, too fast for steps of {1e3 * dt:.3g} ms; "
                f"expected a smoothing of at least {enough:.2g} rad/s, or more inner_steps"
            )

    def draws(self, begin: int, end: int) -> Draws:
        """Return the draws of the runs begin .. end - 1, which depend only on the numbers of the runs."""
        n, count = self.scenario.robot.n, end - begin
        limit = np.asarray(self._settings.effort)
        fixed: dict[str, Any] = {"effort_limit": np.tile(limit, (count, 1))}
        for name, distribution in self.vary.items():
            values = distribution.drawn(name, self.seed, begin, count, n)
            per_joint = distribution.kind == distributions.FIXED and values.ndim and name not in PER_RUN
            fixed[name] = np.tile(values, (count, 1)) if per_joint else values
            if name == "payload_position" and not per_joint and values.ndim:  # one number per run for x, y and z
                fixed[name] = values[:, None]
        if self.identified is not None:
            fixed |= self.identified.drawn(self.seed, begin, count)
        seeds = counter_rng.rows((self.seed, distributions.stream(NOISE_SEED)), begin, count, 1)[:, 0]
        return Draws(count, **fixed, seed=seeds)

    def part(self, begin: int, end: int) -> Columns:
        """Run begin .. end - 1; return number, draws, success and outcomes as columns by name."""
        draws = self.draws(begin, end)
        outcomes = self.loop.run(draws)
        drawn = {
            column: draws.columns(name, self.scenario.robot.n)[:, index]
            for name in self.drawn
            for column, index in zip(self.columns(name), self._indices(name), strict=True)
        }
        results = {key: values for name in FIELDS for key, values in self._columns_of(name, outcomes).items()}
        return {"run": np.arange(begin, end), **drawn, "success": self.succeeded(outcomes), **results}

    def succeeded(self, outcomes: Outcomes) -> NDArray[np.bool_]:
        """Return which runs (k,) are stable, were not stopped and are within all limits of success."""
        kept = [np.asarray(getattr(outcomes, name)) <= limit for name, limit in self.success.items()]
        each = [one.all(axis=1) if one.ndim > 1 else one for one in kept]
        return np.asarray(np.logical_and.reduce([outcomes.stable, outcomes.cause == "", *each]))

    @cached_property
    def _settings(self) -> Settings:
        return safety(self.scenario.controller_values, self.scenario.robot)

    @property
    def drawn(self) -> list[str]:
        """Names of the parameters that differ between runs."""
        varied = [name for name, one in self.vary.items() if one.kind != distributions.FIXED]
        return [*varied, *self._from_posterior]

    @cached_property
    def identified(self) -> PosteriorDraws | None:
        """Draws from the posterior; raises ParameterError."""
        if self.posterior is None:
            return None
        found = Identification.from_dict(self.posterior)
        return PosteriorDraws(found, self.scenario.plant.robot, self.scenario.joints)

    @property
    def _from_posterior(self) -> Mapping[str, tuple[Column, ...]]:
        return {} if self.identified is None else self.identified.columns

    def distributions(self, name: str) -> list[Distribution]:
        """Return the distribution of each column of a drawn parameter."""
        if name in self._from_posterior:
            return [column.marginal for column in self._from_posterior[name]]
        return [self.vary[name]] * len(self.columns(name))

    def is_logarithmic(self, column: str) -> bool:
        """Return whether the values of a column spread evenly on a logarithmic scale."""
        name = column.partition(".")[0]
        return name in self.vary and self.vary[name].kind == distributions.LOG_UNIFORM

    def _indices(self, name: str) -> list[int]:
        """Return the indices of the columns of a drawn parameter in Draws.columns."""
        if name in self._from_posterior:
            return [column.entry for column in self._from_posterior[name]]
        return list(range(len(self.columns(name))))

    def columns(self, name: str) -> list[str]:
        """Return the column names of a drawn parameter: one, or one per joint."""
        if name in self._from_posterior:
            return column_names(self._from_posterior[name], name)
        joints = self.scenario.joints
        return [f"{name}.{joint}" for joint in joints] if self.vary[name].each_joint else [name]

    @property
    def text(self) -> str:
        """Study as JSON; studies with equal text have equal results."""
        values = {name: getattr(self, name) for name in _PLAIN}
        vary = {name: one.as_yaml for name, one in self.vary.items()}
        extra = {} if self.posterior is None else {"posterior": dict(self.posterior)}
        return json.dumps({**values, "vary": vary, "success": dict(self.success), **extra}, indent=1)

    def _columns_of(self, name: str, outcomes: Outcomes) -> Columns:
        values = getattr(outcomes, name)
        if name not in PER_JOINT:
            return {name: values}
        return {f"{name}.{joint}": column for joint, column in zip(self.scenario.joints, values.T, strict=True)}

    def _check(self, name: str, one: Distribution) -> None:
        if name not in LEVELS:
            raise ParameterError(f"'vary' has '{name}'; expected some of {', '.join(LEVELS)}")
        if one.each_joint and (name in PER_RUN or name == "payload_position"):
            raise ParameterError(f"'{name}' has each_joint; expected one value for all joints")
        if one.kind == distributions.FIXED:
            self._check_fixed(name, len(one.numbers))
            return
        try:
            Draws(2, **{name: np.array(one.range)})
        except ParameterError as error:
            raise ParameterError(f"'vary': {error}, for every draw") from None

    def _check_fixed(self, name: str, given: int) -> None:
        most = 1 if name in PER_RUN else width(name, self.scenario.robot.n)
        if given not in (1, most):
            expected = "a single one" if most == 1 else f"1 or {most}"
            raise ParameterError(f"'vary': {name} has {given} numbers; expected {expected}")


_PLAIN = ("name", "scenario_text", "runs", "duration", "seed", "settle_after", "band", "lost")


def from_text(text: str) -> Sweep:
    """Return the study described by Sweep.text."""
    values = json.loads(text)
    vary = {name: distributions.read(name, given) for name, given in values.pop("vary").items()}
    return Sweep(**values, vary=vary)


_recent = lru_cache(maxsize=2)(from_text)
_building = threading.Lock()


def run_part(text: str, begin: int, end: int) -> Columns:
    """Run a part of a study given as text, in a local or remote worker; see Sweep.part."""
    with _building:  # once for all threads of a process
        sweep = _recent(text)
        sweep.loop.build()
    return sweep.part(begin, end)
