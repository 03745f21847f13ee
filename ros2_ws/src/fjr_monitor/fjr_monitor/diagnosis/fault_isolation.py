# SPDX-License-Identifier: Apache-2.0
"""Isolate the fault that best explains a record: kind, joint, side and size.

Three checks in this order: the wiring (exchanged joints, wrong signs), velocities that contradict their positions, the
single fault that explains the residual torques. The first check that finds a fault ends the search, because the fault
masks the later ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.numerics import jit
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import CFunction, WorkSpace
from fjr_core.runtime.events import Finding
from fjr_core.runtime.library import rigid_arm_functions, step_library, write_robot

from .record import Innovations, Record, blocks_of
from .residuals import FEWEST_BLOCKS, deviation, explained_share, residuals
from .thresholds import BLOCK, LONGEST_GAP
from .torque_faults import EXPLAINED, UNKNOWN, torque_fault

CONTRADICTION = 5.0  # standard deviations; smallest difference of a wrong velocity from the slope of its position
JUMPS, OTHERS = 2, 0.01
"""Blocks in which a position jumps, and the share of the power that others have, if an encoder slips."""
DISCRETISED = 5e-4  # difference relative to the speed that is attributed to discretisation
REVERSED = (-3.0, -1.4)  # range of the relative error of scale that is reported as a wrong sign
MOST_STATES = 10_000  # used of a record
STARTING = 400  # states at the start of a record in which the wiring is checked


def isolate(
    record: Record, found: Innovations, late: Array, law: TrackingLaw, names: Sequence[str]
) -> tuple[Finding, ...]:
    """Return the faults of a record, the worst first; empty if none is found or the data do not suffice.

    record: at most MOST_STATES states, the first and the last of a longer one. found: innovations of the intervals in
    which no motor was saturated. late (k, n) [N m]: acting minus sent effort there. names (n,): of the joints.
    """
    with np.errstate(all="ignore"):
        wiring = wiring_fault(record, law.robot, names)
        if wiring is not None:
            return (wiring,)
        contradicted = velocity_faults(record, names)
        if contradicted:
            return contradicted
        seen = residuals(replace(found, t=found.t - record.t[:1]), late, law)
        return () if seen is None else torque_fault(seen, names)


class WiringCheck:
    """The check of the wiring by the control step (wiring.c) alone, for recorded states.

    It compares samples and efforts from the start until every joint is right or a fault is found. names (n,): of the
    joints. Raises CompilerError without a C compiler.
    """

    def __init__(self, robot: Robot, names: Sequence[str]) -> None:
        self._names = names
        library = step_library(robot.n)
        self._ffi, self._lib = library.ffi, library.lib
        functions = {name: jit.compiled(f) for name, f in rigid_arm_functions(robot).items()}
        self._held = {name: CFunction(self._ffi, function) for name, function in functions.items()}
        self._work = WorkSpace(self._ffi, list(functions.values()))
        self._model, self.state = self._ffi.new("struct fjr_model *"), self._ffi.new("struct fjr_wiring *")
        for name, each in self._held.items():
            setattr(self._model, name, each.pointer)
        self._work.lend(self._model)
        write_robot(self._model, robot)
        self._lib.fjr_wiring_start(self.state)

    def skip(self) -> None:
        """Discard the samples so far; the next one does not follow them."""
        self._lib.fjr_wiring_skip(self.state)

    @property
    def done(self) -> bool:
        """Return whether all signals of all joints are known to be right."""
        return bool(self._lib.fjr_wiring_is_right(self.state))

    def see(self, t: float, q: Array, dq: Array) -> Finding | None:
        """Take the state q, dq (2n,) at time t [s]; return the fault once consecutive comparisons agree on it."""
        self._lib.fjr_wiring_see(self.state, t, self._pointer(q), self._pointer(dq))
        self._lib.fjr_wiring_compare(self._model, self.state)
        while self.state.comparing and not self.state.found:  # here nothing waits for an answer
            self.state.waiting = 1
            self._lib.fjr_wiring_compare(self._model, self.state)
        return Finding.of_wiring(self.state.fault, self._names) if self.state.found else None

    def sent(self, u: Array) -> None:
        """Take the command u (n,) [N m] for the last state."""
        self._lib.fjr_wiring_sent(self.state, self._pointer(u))

    def _pointer(self, values: Array) -> Any:
        return self._ffi.from_buffer("double[]", np.ascontiguousarray(values, dtype=float))


def wiring_fault(record: Record, robot: Robot, names: Sequence[str]) -> Finding | None:
    """Check the wiring on the first states of a record, as the running controller does."""
    check = WiringCheck(robot, names)
    longest = LONGEST_GAP * record.sample_period
    for k in range(min(STARTING, len(record.t))):
        if not (np.isfinite(record.position[k]).all() and np.isfinite(record.velocity[k]).all()):
            return None
        if k and not 0 < record.t[k] - record.t[k - 1] < longest:
            check.skip()
        fault = check.see(float(record.t[k]), record.position[k], record.velocity[k])
        if fault is not None or check.done or not np.isfinite(record.u[k]).all():
            return fault
        check.sent(record.u[k])
    return None


def velocity_faults(record: Record, names: Sequence[str]) -> tuple[Finding, ...]:
    """Return the measured velocities that contradict the slope of their positions, the worst first; without a model.

    The slope D and the mean velocity V of each block of intervals are compared. V - D is regressed on D (scale or
    sign), on -dD/dt (delay) and on D of another joint of the same side minus its own.
    """
    first = record.consecutive()
    block = int(np.clip(len(first) // FEWEST_BLOCKS, 1, BLOCK))
    if len(first) < FEWEST_BLOCKS or not np.isfinite(record.position[first]).all():
        return ()
    dt = np.diff(record.t)[first][:, None]
    slope = (record.position[first + 1] - record.position[first]) / dt
    dq, ddq = record.velocity, np.gradient(record.velocity, axis=0)  # ddq times the sample period
    mean = (dq[first + 1] + dq[first]) / 2 - (ddq[first + 1] - ddq[first]) / 12  # trapezoidal rule, first correction
    change = np.gradient(slope, axis=0) / np.median(dt)
    D, V, dD = (blocks_of(values, block).mean(axis=1) for values in (slope, mean, change))
    found: list[tuple[float, Finding]] = []
    for channel in range(D.shape[1]):
        e = V[:, channel] - D[:, channel]
        noise = deviation(e[:, None])[0]
        sigma = float(np.hypot(noise, DISCRETISED * np.sqrt(np.mean(D[:, channel] ** 2)) + 1e-9))
        power = float(np.mean(e**2)) / sigma**2
        slipped = np.sort(e**2)[:-JUMPS].sum() < OTHERS * np.sum(e**2)
        if power > CONTRADICTION**2 and not slipped:
            found.append((power, _contradicted(channel, e, noise, D, dD, names)))
    return tuple(finding for _, finding in sorted(found, key=lambda each: -each[0]))


def _contradicted(channel: int, e: Array, noise: float, D: Array, dD: Array, names: Sequence[str]) -> Finding:
    """Return the fault that best explains the difference e (b,) of a velocity from the slopes D (b, 2n)."""
    n = len(names)
    tried = [("velocity scale", D[:, channel], 0), ("velocity delay", -dD[:, channel], 0)]
    others = range(n * (channel // n), n * (channel // n) + n)
    tried += [("velocity of another joint", D[:, k] - D[:, channel], k) for k in others if k != channel]
    fits = []
    for kind, x, k in tried:
        factor = float(e @ x) / max(float(x @ x), 1e-300)
        if kind != "velocity of another joint" or abs(factor - 1) < 0.2:
            fits.append((float(((e - factor * x) ** 2).sum()), factor, kind, k))
    left, factor, kind, k = min(fits)
    total, noisy = float((e**2).sum()), len(e) * noise**2
    share = explained_share(left - noisy, total - noisy)
    size, unit, what = np.nan, "", "contradicts the slope of the position"
    if share < EXPLAINED or (kind == "velocity delay" and factor < 0):
        kind = UNKNOWN
    elif kind == "velocity scale" and REVERSED[0] < factor < REVERSED[1]:
        kind, size, what = "velocity sign", -1.0, "has the wrong sign"
    elif kind == "velocity scale":
        size, unit, what = 100 * factor, "%", f"is {100 * factor:+.3g} % off the slope of the position"
    elif kind == "velocity delay":
        size, unit, what = factor, "s", f"is {1e3 * factor:.3g} ms late"
    else:
        size, what = float(k), f"is that of {names[k % n]}"
    side, joint = ("link", "motor")[channel // n], names[channel % n]
    return Finding(kind, joint, side, size, unit, share, f"{side} of {joint}: the measured velocity {what}")
