# SPDX-License-Identifier: Apache-2.0
"""Prepare a law of a comparison: by the rule of equal bandwidth (docs/compare.md), or tuned to stated uncertainties.

Tuned laws have the same cost, draws and number of candidates, each with its robust options.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import ParameterError, prefixed
from fjr_core.extensions.python_code import own_law
from fjr_core.files.importing import is_named
from fjr_core.law.interfaces import SampledLaw
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import Robust, sampled_law
from fjr_core.stability.linearization import spectral_radius
from fjr_msgs_py.console.output import finite

from ..batch.draws import FIXED, Distribution, varied
from ..tuning.equal_bandwidth import baseline_target, tune
from .sweep import Sweep, mapping, number, whole
from .trial import MotionDemand, fields_of, imperfection
from .tune import (
    FEW,
    GOAL,
    HERE,
    SIZE,
    Figures,
    Goal,
    Point,
    Range,
    TuningStudy,
    given_goal,
    quantile,
    search,
    with_better_start,
)

NUMBERS: Mapping[str, Callable[[str, object, str], float]] = {"seed": whole, "duration": number, "settle_after": number}
LONGEST = 600.0  # s
OUTER = 0.95  # quantile that is reported beside the median


@dataclass(frozen=True, eq=False)
class TunedLaw:
    """Law with its gains, or the parameters that were chosen, as plain values, and a summary of its tuning.

    effort_limit (n,) [N m]: saturation of every command, the same for all laws. figures: on fresh draws, of a law that
    was tuned to uncertainties.
    """

    law: SampledLaw
    effort_limit: Array
    gains: Mapping[str, Any]
    tuning: str
    figures: Mapping[str, float | None] = field(default_factory=dict)


def tuned_law(
    name: str,
    robust: Mapping[str, float],
    scenario: Scenario,
    retune: bool = False,
    options: Mapping[str, Any] | None = None,
) -> TunedLaw:
    """Return the law of this name for robot, start and reference of the scenario.

    v-dPBC keeps the gains of the scenario unless retune. robust: fields of Robust except hold, which is the sample
    period. A law of the user, module:Class, is not tuned: it has its options, arguments of its constructor. Raises
    FjrError if there is no such law or no stable gains.
    """
    target = baseline_target(scenario)
    hold = Robust(**robust, hold=scenario.sample_period)
    if is_named(name):
        own, options = own_law(name, scenario.robot, options or {}, compile=False), options or {}
        law = sampled_law(own, hold)
        bandwidth, peak = target.bandwidth_of(own) / target.bandwidth, target.peak_of(own) / target.peak
        tuning = f"not tuned: bandwidth {bandwidth:.2g} times the target, peak effort {peak:.2g} times the target"
        return TunedLaw(law, target.effort_limit, dict(options), tuning + _unstable(law, scenario))
    found = tune(name, target, retune=retune)
    law = sampled_law(found.law, hold)
    gains = {**_plain(found.law.gains), **_plain(found, "omega", "damping")}
    return TunedLaw(law, target.effort_limit, gains, found.sentence + _unstable(law, scenario))


def _unstable(law: SampledLaw, scenario: Scenario) -> str:
    """Return a note if the sampled loop is unstable along the reference, else an empty string."""
    where, period = scenario.configurations(FEW), scenario.sample_period
    radius = spectral_radius(law, period, scenario.loop_delay, where, scenario.plant).max()
    return "" if radius < 1 else f"; unstable as sampled: spectral radius {radius:.4g}"


def _plain(value: Any, *names: str) -> dict[str, Any]:
    """Return the finite arrays and numbers of a dataclass as plain values."""
    arrays = {name: np.asarray(getattr(value, name)) for name in names or [field.name for field in fields(value)]}
    return {name: array.tolist() for name, array in arrays.items() if np.isfinite(array).all()}


USUAL: Mapping[str, Any] = {
    "vary": {},
    "imperfections": {},
    **asdict(Goal()),
    "candidates": 150,
    "draws": 24,
    "fresh": 400,
    "seed": 1,
    "duration": 3.0,
    "settle_after": 1.0,
}
"""What every law is tuned for where the section `tune` of a comparison is silent: deviations as in a sweep file, levels
of imperfections, the fields of Goal, numbers of TuningStudy and of Sweep."""


def uncertainties(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the section `tune` of a comparison, checked and complete; raises ParameterError, CompareError.

    A deviation under its former name is reported and has its present one in the result, which worker processes read.
    """
    goal, size = given_goal(section, list(USUAL))
    found = {**USUAL, **goal, **size}
    found |= {key: mapping(key, section[key], HERE) for key in ("vary", "imperfections") if key in section}
    found |= {key: read(key, section[key], HERE) for key, read in NUMBERS.items() if key in section}
    levels = {name: number(name, level, HERE) for name, level in found["imperfections"].items()}
    found["imperfections"] = {name: imperfection(name).checked(level) for name, level in levels.items()}
    with prefixed("'tune': "):
        Goal(**{name: found[name] for name in GOAL})
        if not 0 <= found["settle_after"] < found["duration"] <= LONGEST:
            raise ParameterError(
                f"'settle_after' is {found['settle_after']} and 'duration' {found['duration']} s; expected 0 to less "
                f"than the duration, and this at most {LONGEST:g} s"
            )
        found["vary"] = {name: one.as_yaml for name, one in varied(found["vary"]).items()}
    return found


def law_for(
    text: str,
    wanted: Mapping[str, Any],
    demand: MotionDemand,
    effort_limit: Array,
    tracks: float,
    on_progress: Callable[[float], None],
) -> TunedLaw:
    """Return the law of a scenario, given as its text, tuned to what `uncertainties` returned. Raises FjrError.

    demand: of the motion, for the levels. effort_limit (n,) [N m]: of every command. tracks: a run succeeds if its
    error is at most this fraction of the motion, at every joint. on_progress: called with the share done, 0 to 1.
    """
    study = with_better_start(_study(text, wanted, demand, effort_limit, tracks))
    done = 0

    def figures(points: Sequence[Point], runs: Range) -> list[Figures]:
        nonlocal done
        done += len(points) * (runs[1] - runs[0])
        found = [study.run(point, *runs) for point in points]
        on_progress(min(1.0, done / study.searched))
        return found

    found = search(study, figures)
    fresh = study.run(found.chosen, *study.fresh_runs)
    score = study.score(found.chosen, fresh)
    summary = {"rms": score.figures["rms"], "rms_outer": quantile(fresh["rms"], OUTER), "success": score.success}
    summary |= {name: score.figures[name] for name in ("effort_noise", "effort_peak")}
    tracking = f"on {study.fresh} fresh draws {100 * score.success:.3g} % track"
    return TunedLaw(
        study.coordinates.controller(found.chosen)[0],
        effort_limit,
        study.coordinates.values(found.chosen),
        f"best of {len(found.candidates)} candidates; {tracking}",
        finite(summary),
    )


def _study(
    text: str, wanted: Mapping[str, Any], demand: MotionDemand, effort_limit: Array, tracks: float
) -> TuningStudy:
    """Return the study of a law: its draws vary as stated, its imperfections have fixed levels."""
    scenario = parse_scenario("tuned", text)
    step = scenario.sample_period / scenario.inner_steps
    fixed = {"effort_limit": effort_limit, **fields_of(wanted["imperfections"], demand, step)}
    vary = varied(wanted["vary"])
    vary |= {name: Distribution(FIXED, tuple(np.atleast_1d(value).tolist())) for name, value in fixed.items()}
    numbers, size = ({name: wanted[name] for name in names} for names in (NUMBERS, SIZE))
    sweep = Sweep("tuned", text, 1, vary, success={"rms": tracks * demand.motion}, **numbers)
    return TuningStudy(sweep, Goal(**{name: wanted[name] for name in GOAL}), **size)
