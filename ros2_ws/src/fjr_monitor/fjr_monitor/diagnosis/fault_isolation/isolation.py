# SPDX-License-Identifier: Apache-2.0
"""Isolate the single fault that best explains the residual torques of a record: kind, joint, side and size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, Prediction
from fjr_core.monitoring.thresholds import LONGEST_GAP
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import WiringFault

from ..delay_estimation import acting, effort_delay
from ..innovations import innovations, needed
from ..record import Ends, Record
from ..wiring import WiringCheck
from .hypotheses import Hypothesis, hypotheses
from .torque_residuals import Residuals, residuals
from .velocity_consistency import VelocityFault, velocity_faults

UNKNOWN = "unknown"
SIGNIFICANT = 4.0
"""Smallest residual torque of a fault, in standard deviations of noise and rounding."""
EXPLAINED = 0.8
"""Share of the residual (R^2 without noise) that a fault must explain to be reported."""
ADVANTAGE = 0.7
"""Report a fault only if it leaves less than this fraction of what the next best kind or joint leaves."""
NEAREST = 0.1
"""Smallest share of the residual that the nearest kind must explain to be named where no fault is reported."""

LONGEST = 10_000
"""Largest number of states used."""
STARTING = 400
"""Number of states at the start of a record in which the wiring is checked."""


@dataclass(frozen=True)
class Finding:
    """Fault of a robot or its signals.

    kind: e.g. "Coulomb friction"; "unknown". joint: its name ("a and b" if two are exchanged), empty if unknown.
    side: "link", "motor", "joint" (the spring between the two) or empty. size, unit: magnitude. share: part of the
    residual torque that the fault explains.
    """

    kind: str
    joint: str
    side: str
    size: float
    unit: str
    share: float
    sentence: str


def isolate(record: Record, law: TrackingLaw, joints: Sequence[str] = ()) -> tuple[Finding, ...]:
    """Return the faults of a record, the worst first; empty if none is found or the data do not suffice.

    Three checks in this order: wiring (exchanged joints, wrong signs), velocities that contradict their positions, the
    single fault that explains the residual torques. The first check that finds a fault ends the search, because the
    fault masks the later ones. joints: names (n,); default joint1 .. jointn. Of a record longer than LONGEST states the
    middle is ignored.
    """
    names = list(joints) or [f"joint{j + 1}" for j in range(law.robot.n)]
    if len(record.t) > LONGEST:
        ends = Ends(LONGEST // 2)
        ends.add(record)
        record = ends.record()
    with np.errstate(all="ignore"):
        wiring = _wiring(record, law)
        if wiring is not None:
            return (_of_wiring(wiring, names),)
        contradicted = velocity_faults(record)
        if contradicted:
            return tuple(_of_velocity(fault, names) for fault in contradicted)
        found = innovations(record, Certificate(law), Prediction(law))
        if not len(found):
            return ()
        acted = acting(found, effort_delay(found, law.robot), needed(found, law.robot))
        seen = residuals(record, law, found, acted)
        return () if seen is None else _named(seen, names)


def _wiring(record: Record, law: TrackingLaw) -> WiringFault | None:
    """Check the wiring on the first states of a record, as the running controller does."""
    check = WiringCheck(law.robot)
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


def _of_wiring(fault: WiringFault, names: list[str]) -> Finding:
    """Return the finding of a wiring fault."""
    concerned = fault.joints[:1] if fault.kind == "velocity of another joint" else fault.joints
    joint = " and ".join(names[j] for j in concerned)
    return Finding(fault.kind, joint, fault.side, float("nan"), "", 1.0, fault.sentence(names))


def _of_velocity(fault: VelocityFault, names: list[str]) -> Finding:
    """Return the finding of a velocity that contradicts its position."""
    side, joint = ("link", "motor")[fault.channel // len(names)], names[fault.channel % len(names)]
    sentences = {
        UNKNOWN: "the measured velocity contradicts the slope of the position",
        "velocity sign": "the measured velocity has the wrong sign",
        "velocity scale": f"the measured velocity is {fault.size:+.3g} % off the slope of the position",
        "velocity delay": f"the measured velocity is {1e3 * fault.size:.3g} ms late",
    }
    other = "" if fault.kind in sentences else names[int(fault.size) % len(names)]
    sentence = sentences.get(fault.kind, f"the measured velocity is that of {other}")
    return Finding(fault.kind, joint, side, fault.size, fault.unit, fault.share, f"{_where(side, joint)}: {sentence}")


@dataclass(frozen=True, eq=False)
class Fit:
    """Hypothesis with its fitted size and the weighted residual sum of squares `left`."""

    fault: Hypothesis
    size: float
    left: float


def fits(seen: Residuals) -> list[Fit]:
    """Return all hypotheses fitted to the residuals, best first."""
    y = (seen.r / seen.sigma).ravel()
    fitted = (_fit(fault, y, seen.sigma) for fault in hypotheses(seen))
    return sorted((fit for fit in fitted if fit is not None), key=lambda fit: fit.left)


def _fit(fault: Hypothesis, y: Array, sigma: Array) -> Fit | None:
    X = (fault.columns / sigma[:, None]).reshape(len(y), -1)
    if not np.isfinite(X).all() or not X.any():
        return None
    if fault.nonlinear is None:
        theta = np.asarray(np.linalg.lstsq(X, y, rcond=1e-8)[0], dtype=float)
    else:
        theta = fault.nonlinear(X.T @ X, X.T @ y)
    size = fault.size(theta)
    return None if size is None else Fit(fault, size, float(((y - X @ theta) ** 2).sum()))


def _named(seen: Residuals, names: list[str]) -> tuple[Finding, ...]:
    power = ((seen.r / seen.sigma) ** 2).mean(axis=0)
    if not np.isfinite(power).all() or power.max() < SIGNIFICANT**2:
        return ()
    total, noise = float(power.sum() * len(seen.r)), float(((seen.noise / seen.sigma) ** 2).sum() * len(seen.r))
    found = fits(seen)
    best = found[0]
    other = next(fit for fit in found if (fit.fault.kind, fit.fault.joint) != (best.fault.kind, best.fault.joint))
    share = float(np.clip(1 - max(best.left - noise, 0.0) / max(total - noise, 1e-300), 0.0, 1.0))
    rest = [max(fit.left - noise, 0.0) for fit in (best, other)]
    if share < EXPLAINED or rest[0] > ADVANTAGE * rest[1]:
        return (_unknown(best, share, names),)
    return (_finding(best, share, names),)


def _finding(fit: Fit, share: float, names: list[str]) -> Finding:
    fault, joint = fit.fault, names[fit.fault.joint]
    what = f"{fault.kind} of {fit.size:.3g} {fault.unit}"
    sentence = f"{_where(fault.side, joint)}: {what} explains {100 * share:.0f} % of the residual torque"
    return Finding(fault.kind, joint, fault.side, fit.size, fault.unit, share, sentence)


def _unknown(best: Fit, share: float, names: list[str]) -> Finding:
    sentence = "no single fault explains the residual torque"
    if share >= NEAREST:
        where = _where(best.fault.side, names[best.fault.joint])
        sentence += f"; the nearest, {best.fault.kind} ({where}), explains {100 * share:.0f} %"
    return Finding(UNKNOWN, "", "", float("nan"), "", share, sentence)


def _where(side: str, joint: str) -> str:
    return joint if side == "joint" else f"{side} of {joint}"
