# SPDX-License-Identifier: Apache-2.0
"""Bound the tracking error of a sampled loop along a reference, for model errors, hold and delay (docs/method.md).

The box of the robot's factors is divided until each part has an invariant tube about its own steady motion; the bound
is the largest of the parts. With sines as the reference every constant is enclosed by Taylor models, and the bound is
proven. Otherwise the ranges are those of random points of the same boxes: sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.law.interfaces import StaticLaw
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import one_line
from fjr_core.stability.sampled_loop import checked_times

from .deviation_model import FACTORS
from .part import Part
from .search import Progress, Search

TORQUES = ("link_torque", "motor_torque")
"""Names of errors in N m; the others, FACTORS, are relative."""
SECONDS_TO_PROVE = 2  # joints
LARGEST = 0.9  # relative error of a factor


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """Bound of the deviations from the reference for all model errors up to `errors`.

    position, velocity (n,) [rad, rad/s]: ultimate bounds of |q_l - q_ld| and |dq_l - dq_ld| in steady motion; infinite
    if no invariant tube was found. from_start (n,) [rad]: bound of the positions at all times for a robot that starts
    on the reference, and then ends within `position`; infinite unless proven. errors: relative errors of FACTORS, and
    TORQUES in N m. storage [J]: ultimate bound of V in steady motion; nan if the law has none. parts: number of parts
    of the box of factors. proven: every constant is verified; otherwise the bound rests on sampled constants.
    """

    position: Array
    velocity: Array
    from_start: Array
    storage: float
    errors: Mapping[str, float]
    sample_period: float
    delay: float
    parts: int
    proven: bool

    __repr__ = one_line

    @property
    def found(self) -> bool:
        """True if the bound is finite."""
        return bool(np.all(np.isfinite(self.position)))


def bound_errors(
    law: StaticLaw,
    reference: Reference,
    sample_period: float,
    delay: float = 0.0,
    errors: Mapping[str, float] = {},
    progress: Progress = lambda share: None,
    prove: bool | None = None,
) -> ErrorBound:
    """Return a bound of the tracking errors on the reference of the law sampled every sample_period [s].

    delay [s]: constant, from a state to the effort that answers it. errors: largest relative errors of the robot's
    factors (FACTORS: one factor for all joints, "payload" for inertia and weight of the links together), and largest
    TORQUES [N m] that act at any joint with any time course. progress: see `search.Progress`. prove: whether a proof is
    tried; None: where it takes seconds, with up to SECONDS_TO_PROVE joints or without an error of a factor.
    Raises ParameterError for an unknown name, an error that is negative or too large, and a reference that has neither
    a common period nor an end within 60 s; StateError unless the sample period is positive and the delay not negative;
    CompilerError without a C compiler.
    """
    checked_times(sample_period, delay)
    checked = _checked(errors)
    half = np.array([checked.get(name, 0.0) for name in FACTORS])
    disturbing = np.repeat([checked.get(name, 0.0) for name in TORQUES], law.robot.n)
    given = law, reference, sample_period, delay, disturbing
    search = Search(*given, verified=True)
    if prove is None:
        prove = law.robot.n <= SECONDS_TO_PROVE or not np.any(half)
    if prove and search.applies:
        parts = search.parts(1 - half, 1 + half, progress)
        if all(part.found for part in parts):
            return _result(parts, law.robot.n, checked, (sample_period, delay), proven=True)
    parts = Search(*given, verified=False).parts(1 - half, 1 + half, progress)
    return _result(parts, law.robot.n, checked, (sample_period, delay), proven=False)


def _result(
    parts: Sequence[Part], n: int, errors: Mapping[str, float], times: tuple[float, float], proven: bool
) -> ErrorBound:
    ultimate = np.max([part.ultimate for part in parts], axis=0)
    start = np.max([part.from_start for part in parts], axis=0)
    storage = float(np.max([part.storage for part in parts]))
    return ErrorBound(ultimate[:n], ultimate[n:], start[:n], storage, errors, *times, len(parts), proven)


def _checked(errors: Mapping[str, float]) -> dict[str, float]:
    for name, value in errors.items():
        if name not in (*FACTORS, *TORQUES):
            raise ParameterError(f"error '{name}' is unknown; expected some of {', '.join((*FACTORS, *TORQUES))}")
        limit = LARGEST if name in FACTORS else np.inf
        if not 0 <= value <= limit or not np.isfinite(value):
            raise ParameterError(f"error '{name}' is {value}; expected 0 to {limit}")
    return dict(errors)
