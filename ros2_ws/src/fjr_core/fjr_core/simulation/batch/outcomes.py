# SPDX-License-Identifier: Apache-2.0
"""Outcomes of k runs, one row of numbers per run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array
from ...runtime.events import KINDS, STARTS_REFUSED, STOPS


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of k runs of n joints; errors are q_l - q_ld at the samples, efforts the saturated commands.

    stable (k,): all numbers are finite and no error exceeds ClosedLoop.lost; lost_at (k,) [s]: end of a run that is not
    stable, else inf. rms, peak (k, n) [rad]: of the errors after settle_after. final (k, n) [rad]: mean magnitude of
    the errors over the last second. settling (k,) [s]: instant after which every error stays within ClosedLoop.band;
    inf: never. effort_rms, effort_peak (k, n) [N m]: from the start. effort_noise (k, n) [N m]: RMS of
    (u_k - u_(k-1)) / 2^(1/2) after settle_after, the standard deviation of white noise in the effort. power (k,) [W]:
    mean of |u' dq_m|.
    For a run that is not stable, rms, peak, final and settling are inf and the others cover the run up to lost_at.
    stopped (k,) [s]: time at which a limit stopped the controller, inf: none. cause (k,): of the stop, e.g. "link
    velocity", else empty. A stopped run continues under the stop policy, and its error may exceed ClosedLoop.lost.
    """

    stable: NDArray[np.bool_]
    lost_at: Array
    rms: Array
    peak: Array
    final: Array
    settling: Array
    effort_rms: Array
    effort_peak: Array
    effort_noise: Array
    power: Array
    stopped: Array
    cause: NDArray[np.str_]

    @classmethod
    def of(cls, rows: Array, n: int) -> Outcomes:
        """Return the outcomes from rows (k, width(n)) of the engine, which hold the fields in order."""
        ends = np.cumsum([0, *(n if name in PER_JOINT else 1 for name in FIELDS)])
        parts = {
            name: rows[:, start:end] if name in PER_JOINT else rows[:, start]
            for name, start, end in zip(FIELDS, ends, ends[1:], strict=False)
        }
        causes = np.array([_CAUSES.get(int(kind), "") for kind in parts["cause"]], dtype=str)
        return cls(**{**parts, "stable": parts["stable"] != 0, "cause": causes})

    @classmethod
    def joined(cls, parts: Sequence[Outcomes]) -> Outcomes:
        """Concatenate the runs of several outcomes."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS))


FIELDS = tuple(field.name for field in fields(Outcomes))
_CAUSES = {
    k: name.removeprefix(f"{STOPS}: ") for k, name in enumerate(KINDS) if name.startswith((f"{STOPS}:", STARTS_REFUSED))
}
"""Causes of a stop by the number that the control step gives them."""
PER_JOINT = ("rms", "peak", "final", "effort_rms", "effort_peak", "effort_noise")


def width(n: int) -> int:
    """Return the length of a row for n joints."""
    return sum(n if name in PER_JOINT else 1 for name in FIELDS)
