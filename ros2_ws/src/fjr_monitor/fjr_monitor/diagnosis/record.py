# SPDX-License-Identifier: Apache-2.0
"""The values of a diagnosis: a record, what was measured and sent at each instant, and innovations along it.

An innovation is a measured state minus its one-step-ahead prediction by the model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import StateError
from fjr_core.motions.reference import JETS
from fjr_core.numerics.checks import Array, floats, positive
from fjr_core.numerics.one_line import joints, span

from .thresholds import AT_LIMIT, LONGEST_GAP

LEAD = 2
"""States of the part before that a part of a record repeats: an interval needs the effort before it."""
PART = 8192
"""States of a part: what one pass over a record holds in memory."""
T = TypeVar("T", bound="Table")
Part = TypeVar("Part", bound="Record", covariant=True)
Rows = slice | NDArray[np.intp] | NDArray[np.bool_]
HUGE = 1e30
"""Positions and velocities of a diverged robot, at which V may overflow."""


class Table:
    """Arrays with a row for each of k instants or intervals, and values that all of them share; for dataclasses."""

    SHARED: ClassVar[tuple[str, ...]] = ()

    @property
    def columns(self) -> dict[str, Any]:
        """The arrays by name."""
        names = [each.name for each in fields(self) if each.name not in self.SHARED]  # type: ignore[arg-type]
        return {name: values for name in names if (values := getattr(self, name)) is not None}

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def rows(self: T, rows: Rows) -> T:
        """Return the selected rows."""
        return replace(self, **{name: values[rows] for name, values in self.columns.items()})  # type: ignore[type-var]

    def followed_by(self: T, later: T) -> T:
        """Return these rows and later ones."""
        joined = {name: np.concatenate([values, getattr(later, name)]) for name, values in self.columns.items()}
        return replace(self, **joined)  # type: ignore[type-var]


class AnyRecord(Protocol[Part]):
    """A record of any length, which is read in parts; a Record is one."""

    @property
    def step(self) -> float:
        """Median time [s] between two states."""

    def __len__(self) -> int: ...

    def part(self, start: int, end: int) -> Part:
        """Return the states from `start` to `end`, with LEAD states before them."""


def parts_of(record: AnyRecord[Part], size: int = PART) -> Iterator[Part]:
    """Yield a record in parts of `size` states."""
    for start in range(0, len(record), size):
        yield record.part(start, min(start + size, len(record)))


def blocks_of(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Return values (k, ...) as blocks (b, size, ...) of consecutive rows, without an incomplete last block."""
    count = len(values) // size
    return values[: count * size].reshape(count, size, *values.shape[1:])


def held_efforts(u: Array, before: Array | None) -> Array:
    """Return efforts (k, n) with the previous one in place of a missing one; before (n,): the one before all."""
    last = np.maximum.accumulate(np.where(np.isfinite(u).all(axis=1), np.arange(len(u)), -1))
    return np.where((last >= 0)[:, None], u[np.maximum(last, 0)], np.nan if before is None else before)


@dataclass(frozen=True)
class Record(Table):
    """Measured states and commands at k instants.

    t (k,) [s]: time stamps. position, velocity (k, 2n) [rad, rad/s]: links, then motors. jets (k, 5, n): reference.
    u (k, n) [N m]: command for each state, NaN: none. u_applied (k, n) [N m]: measured effort of the motors at each
    state, or None. sent, answered (k,) [s]: send times of states and commands, or None. sample_period [s].
    effort_limit, effort_rate (n,) [N m, N m/s]: largest effort and its largest rate, inf for none. lockstep: the robot
    waits for each command, so that send times carry no information. begin: states that repeat the end of the part
    before, at most LEAD; 0: of a whole record or its first part. before (n,) [N m]: effort that was held before the
    first state, NaN or None: not known.
    Raises StateError for wrong shapes and a sample period that is not positive.
    """

    SHARED: ClassVar[tuple[str, ...]] = ("sample_period", "effort_limit", "lockstep", "begin", "before", "effort_rate")

    t: Array
    position: Array
    velocity: Array
    jets: Array
    u: Array
    u_applied: Array | None
    sent: Array | None
    answered: Array | None
    sample_period: float
    effort_limit: Array
    lockstep: bool = False
    begin: int = 0
    before: Array | None = None
    effort_rate: Array | float = np.inf

    def __repr__(self) -> str:
        n = joints(self.u.shape[1])
        return f"Record({n}, {len(self.t)} instants, {span(self.t)}, sample_period={self.sample_period:.4g} s)"

    def __post_init__(self) -> None:
        for name, values in {**self.columns, "effort_limit": self.effort_limit}.items():
            if not isinstance(values, np.ndarray):  # one is not copied
                object.__setattr__(self, name, floats(name, values, StateError))
        k, n = np.shape(self.u) if np.ndim(self.u) == 2 else (-1, -1)
        shapes = {"t": (k,), "position": (k, 2 * n), "velocity": (k, 2 * n), "jets": (k, JETS, n), "u": (k, n)}
        optional = {"u_applied": (k, n), "sent": (k,), "answered": (k,)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in {**shapes, "effort_limit": (n,)}.items():
            if np.shape(getattr(self, name)) != shape:
                raise StateError(f"{name} has shape {np.shape(getattr(self, name))}; expected {shape}")
        positive("sample_period", self.sample_period, StateError)

    @property
    def step(self) -> float:
        """Median time [s] between two states."""
        return float(np.median(np.diff(self.t))) if len(self.t) > 1 else self.sample_period

    def part(self, start: int, end: int) -> Record:
        """Return the states from `start` to `end`, with LEAD states before them."""
        begin = min(LEAD, start)
        before = self.held[start - begin - 1] if start > begin else self.before
        return replace(self.rows(slice(start - begin, end)), begin=begin, before=before)

    def consecutive(self) -> NDArray[np.intp]:
        """Return the rows with two measured consecutive states, without a gap, with a reference and a known effort.

        A gap is longer than LONGEST_GAP sample periods.
        """
        measured = (np.abs(np.hstack([self.position, self.velocity])) < HUGE).all(axis=1)
        good = np.asarray(measured & np.isfinite(self.jets).all(axis=(1, 2)))
        dt, answered = np.diff(self.t), np.asarray(np.isfinite(self.held).all(axis=1))
        pairs = good[:-1] & good[1:] & answered[:-1]
        pairs[: max(self.begin - 1, 0)] = False
        return np.flatnonzero(pairs & (dt > 0) & (dt < LONGEST_GAP * self.sample_period))

    def known_latency(self) -> Array:
        """Return the time from each state to its command (k,) [s], at most one sample period; 0 where not known."""
        if self.lockstep or self.sent is None or self.answered is None:
            return np.zeros(len(self.t))
        known = np.nan_to_num(np.asarray(self.answered) - np.asarray(self.sent))
        return np.asarray(np.clip(known, 0.0, self.sample_period))

    @cached_property
    def held(self) -> Array:
        """u (k, n) [N m] with the previous effort in place of a missing one."""
        return held_efforts(self.u, self.before)


def limited(u: Array, older: Array, dt: Array, limit: Array, rate: Array | float) -> NDArray[np.bool_]:
    """Return where efforts u (k, n) [N m] are at a limit, or differ from older ones by a rate [N m/s] over dt (k,)."""
    return np.asarray((np.abs(u) >= AT_LIMIT * limit) | (np.abs(u - older) >= AT_LIMIT * rate * dt[:, None]))


@dataclass(frozen=True)
class Innovations(Table):
    """Innovations of k intervals between consecutive states, in order of time.

    t, dt (k,) [s]: begins and lengths. V0, V1, predicted (k,) [J]: storage at the first state, at the second, and
    predicted for the second with the sent effort held. sent, law (k, n) [N m]: sent effort, and that of the law at the
    first state. before, after (k, n) [N m]: measured effort of the motors at both states, NaN: not measured. error (k,
    4n): measured minus predicted positions and velocities of the second state. slope (k, 4n): dV/d of these there.
    answered (k,): true if the first state received a command. older (k, n) [N m]: effort sent before. latency (k,):
    delay of the command by send times as a fraction of the interval, during which the older effort still acts; 0: not
    known. limited (k, n): true where the effort was sent at its limit or changed at its largest rate. tracking (k, n)
    [rad]: q_l - q_ld at the second state. states (k, 2, 4n): positions and velocities at both states, NaN: not kept.
    """

    dt: Array
    V0: Array
    V1: Array
    predicted: Array
    sent: Array
    law: Array
    before: Array
    after: Array
    error: Array
    slope: Array
    answered: NDArray[np.bool_]
    older: Array
    latency: Array
    limited: NDArray[np.bool_]
    tracking: Array
    states: Array
    t: Array
