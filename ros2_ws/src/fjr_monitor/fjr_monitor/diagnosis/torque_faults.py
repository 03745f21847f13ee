# SPDX-License-Identifier: Apache-2.0
"""Find the fault that explains the residual torques of a record, by its likelihood, and since when.

The likelihood is that of Gaussian residuals with the noise of the record. Kinds whose likelihoods differ by no more
than noise, or than what none of them explains, are named together.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import Finding
from fjr_msgs_py.console.output import number, percent

from .hypotheses import BASE, FRICTIONS, JOINT, LINK, MOTOR, Hypothesis, hypotheses
from .residuals import Residuals, explained_share
from .verdict import EXTERNAL

UNKNOWN = "unknown"
EXPLAINED = 0.8
"""Share of a residual (R^2 without noise) that a fault must explain to be reported."""
PRESENT, SIGNIFICANT = 2.0, 4.0
"""Smallest RMS of the residual torque of a fault, and smallest torque of a contact, in standard deviations of noise."""
ADVANTAGE = 0.7
"""Report a fault only if it leaves less than this fraction of what the next best kind or joint leaves."""
ONE_JOINT = 0.98
"""Share that a fault of one joint must explain for it to be no fault of all joints."""
PART = 0.1
"""Smallest part of a residual that friction and another fault explain each, to be named both."""
LIKELIER = 15.0
"""Smallest difference of twice the logarithm of the likelihoods of two kinds that noise does not explain."""
MOST_KINDS = 3  # most kinds of fault that are named together
SLIP = "encoder slip"
ONSETS, EARLIEST = 60, 0.1
"""Instants at which a fault may begin, and the share of a record before which it acts all the time."""
NEAREST = 0.1
"""Smallest share of the residual that the nearest kind must explain to be named where no fault is reported."""
EPISODE = 0.5
"""Largest share of the blocks in which an external torque acts."""
QUIET = 0.1
"""Torque of a joint relative to its largest up to which it does not act."""
NEGLIGIBLE = 0.05
"""External torque relative to that of the joint with the largest up to which a joint is not named."""
DRIVEN = 0.1
"""Share of the energy by a torque that drives a joint, above which it is no friction."""
OF_COMMAND = ("torque constant", "effort limit")  # whose residual is a part of the command
SWINGS = 0.1
"""Largest share of the blocks with an external torque that acts the other way in the next block."""
REACTION = 0.2
"""Largest torque on a motor, relative to the largest on a link, that is attributed to the prediction of the spring."""


class FittedFault(NamedTuple):
    """A fitted fault: weighted sum of squares that it leaves, unknowns (p,), since which block, 0: all the time."""

    left: float
    fitted: Array
    fault: Hypothesis
    onset: int = 0

    @property
    def size(self) -> float:
        """The size of the fault."""
        return float(self.fault.size(self.fitted) or 0.0)

    @property
    def sizes(self) -> dict[str, tuple[float, ...]]:
        """The sizes at all joints, or of several kinds."""
        return {kind: tuple(map(float, sizes)) for kind, sizes in self.fault.sizes(self.fitted).items()}

    @property
    def kind(self) -> str:
        """The kind of fault; an offset of an encoder that comes while the robot moves is a slip."""
        return SLIP if self.onset and self.fault.kind == "position offset" else self.fault.kind

    def place(self, names: Sequence[str]) -> str:
        """Return kind and place of the fault, with the names of the joints."""
        size = f"{self.size:.3g} {self.fault.unit}{self.fault.detail(self.fitted)}"
        return f"{self.fault.place(names)}: {self.kind} of {size}"


class Regression:
    """Fits of hypotheses to the residual torques by least squares, weighted by their noise.

    beside: fault that acts, too, by unknown sizes: what its columns may explain is left out.
    """

    def __init__(self, seen: Residuals, beside: Hypothesis | None = None) -> None:
        self._sigma, self._lasting = seen.sigma, beside is not None
        columns = np.zeros((*seen.r.shape, 0)) if beside is None else beside.columns
        self._basis = np.linalg.qr(self._weighted(columns).reshape(seen.r.size, -1))[0]
        self._y = self._normal(seen.r[..., None])[..., 0]

    def fits(self, faults: Iterable[Hypothesis]) -> list[FittedFault]:
        """Return all hypotheses as they fit, best first."""
        found = map(self.fit, faults)
        return sorted((each for each in found if each is not None), key=lambda fit: fit.left)

    def fit(self, fault: Hypothesis) -> FittedFault | None:
        """Return a hypothesis as it fits, with its most likely begin; None if it is impossible."""
        X, y = self._normal(fault.columns), self._y
        if not np.isfinite(X).all() or not X.any():
            return None
        A, c = np.einsum("bip,biq->bpq", X, X), np.einsum("bip,bi->bp", X, y)
        if fault.nonlinear is None:
            theta = np.linalg.pinv(A.sum(axis=0), rcond=1e-12, hermitian=True) @ c.sum(axis=0)
        else:
            theta = fault.nonlinear(A.sum(axis=0), c.sum(axis=0))
        left, onset = float(((y - X @ theta) ** 2).sum()), 0
        contact = (fault.kind, fault.side) == ("constant torque", LINK)  # if it does not last
        if fault.nonlinear is None and not contact and not self._lasting:
            theta, left, onset = _since(A, c, float((y**2).sum()), y.size) or (theta, left, 0)
        if fault.size(theta) is None or (fault.nonlinear is None and theta[0] <= fault.least):
            return None
        return FittedFault(left, theta, fault, onset)

    def _weighted(self, values: Array) -> Array:
        return np.asarray(values / self._sigma[..., None])

    def _normal(self, values: Array) -> Array:
        """Return the part of weighted values (b, 2n, p) that is normal to the columns of the other fault."""
        rows = self._weighted(values).reshape(len(self._basis), -1)
        return np.asarray((rows - self._basis @ (self._basis.T @ rows)).reshape(values.shape))


def _since(A: Array, c: Array, total: float, cells: int) -> tuple[Array, float, int] | None:
    """Return coefficients, sum of squares and block at which a fault most likely begins; None if it acts all the time.

    A (b, p, p), c (b, p): X'X and X'y of each block. The likelihood of each block is that of the sums from it on.
    """
    begin = np.unique(np.linspace(0, len(c) - 1, ONSETS + 2).astype(int)[:-1])
    from_on = [np.cumsum(each[::-1], axis=0)[::-1][begin] for each in (A, c)]
    theta = np.einsum("bpq,bq->bp", np.linalg.pinv(from_on[0], rcond=1e-12, hermitian=True), from_on[1])
    left = total - (theta * from_on[1]).sum(axis=1)
    best = int(np.argmin(left))
    if begin[best] < EARLIEST * len(c) or not _clearly(left[best], left[0], cells):
        return None
    return theta[best], float(left[best]), int(begin[best])


def _clearly(left: float, other: float, cells: int) -> bool:
    """Return whether a fit is better than another one by more than noise and than what it leaves itself.

    cells: number of residuals, each of which noise, rounding and discretisation change by one.
    """
    return other - left > LIKELIER and max(left - cells, 0.0) < ADVANTAGE * max(other - cells, 0.0)


def torque_fault(seen: Residuals, names: Sequence[str]) -> tuple[Finding, ...]:
    """Return the fault that explains the residual torques, or "unknown" if none does; nothing if they are small.

    Real gears rub: where friction of all motors explains a part only, another fault may explain the rest.
    """
    if not _present(seen):
        return ()
    faults = list(hypotheses(seen))
    fitted = Regression(seen).fits(faults)
    found, _ = _named(seen, fitted, names)
    everywhere = 0 if seen.robot.n == 1 else None
    of_motors = (each for each in fitted if (each.fault.side, each.fault.joint) == (MOTOR, everywhere))
    rubbing = next((each for each in of_motors if each.kind in FRICTIONS), None)
    if rubbing is None or found.kind not in (UNKNOWN, EXTERNAL, *FRICTIONS) or (found.kind == UNKNOWN and found.joint):
        return (found,)
    rest = replace(seen, r=seen.r - rubbing.fault.columns @ rubbing.fitted)
    left = rubbing.left / float(((seen.r / seen.sigma) ** 2).sum())
    if not PART < left < 1 - PART or not _present(rest):
        return (found,)
    other, best = _named(rest, Regression(rest, rubbing.fault).fits(faults), names, "what friction leaves")
    if other.kind in (UNKNOWN, found.kind):
        return (found,)
    friction = Regression(seen, best.fault).fit(rubbing.fault) or rubbing
    what = f"{friction.place(names)} explains {percent(1 - left, 0)} of the residual torque"
    joint, unit = "" if everywhere is None else names[0], friction.fault.unit
    return Finding(friction.kind, joint, MOTOR, friction.size, unit, 1 - left, what, sizes=friction.sizes), other


def _present(seen: Residuals) -> bool:
    """Return whether the residual torque of an equation is more than noise."""
    power = ((seen.r / seen.sigma) ** 2).mean(axis=0)
    return bool(np.isfinite(power).all() and power.max() >= PRESENT**2)


def _named(
    seen: Residuals, fitted: Sequence[FittedFault], names: Sequence[str], of: str = "the residual torque"
) -> tuple[Finding, FittedFault]:
    """Return the single fault that explains the residual torques, or UNKNOWN, and the best fit.

    Kinds of one joint that fit equally well with as few unknowns are named together; of more than MOST_KINDS only the
    joint is named. If no fault explains enough, torques on links alone, not all the time, are external; else the place
    of the torques is named if there is one.
    """
    total, noise = (float(((each / seen.sigma) ** 2).sum()) for each in (seen.r, seen.noise))
    alone = [each for each in fitted if each.fault.joint is not None or each.fault.side == BASE]
    if explained_share(alone[0].left - noise, total - noise) > ONE_JOINT:
        fitted = alone
    best = fitted[0]
    share = explained_share(best.left - noise, total - noise)
    equal = [each for each in fitted if not _clearly(best.left, each.left, seen.r.size)]
    simplest = min(each.fault.unknowns for each in equal)
    kinds = {(each.kind, each.fault.joint): each for each in reversed(equal) if each.fault.unknowns == simplest}
    several = list(kinds.values())[::-1]
    joints = {names[each.fault.joint] for each in several if each.fault.joint is not None}
    anywhere = at_one_place(seen, names) if several[0].fault.joint is None else None
    if anywhere is not None and 1 - anywhere.share < ADVANTAGE * (1 - share):
        return anywhere, best
    if share < EXPLAINED or len(joints) > 1 or (best.kind in OF_COMMAND and not _acts(seen, best)):
        said = external_torque(seen, names) or at_one_place(seen, names) or unexplained(best, share, names)
        return said, best
    joint = "".join(joints)
    if len(several) > MOST_KINDS:
        what = f"{joint}: no one kind of fault explains the residual torque better than others"
        return Finding(UNKNOWN, joint, share=share, sentence=what), best
    first = several[0]
    what = " or ".join(each.place(names) for each in several) + f" explains {percent(share, 0)} of {of}"
    since = float(seen.found.t[first.onset * seen.block]) if first.onset else 0.0
    what += f" from {number(since, 's')} on" if since else ""
    kind = " or ".join(each.kind for each in several)
    side = first.fault.side if len({each.fault.side for each in several}) == 1 else ""
    return Finding(kind, joint, side, first.size, first.fault.unit, share, what, since, first.sizes), first


def _acts(seen: Residuals, best: FittedFault) -> bool:
    """Return whether a fault of the command explains the effort that acted, too, not only that most is missing."""
    if best.fault.joint is None:
        return True
    y, B = seen.r / seen.sigma, np.append(np.zeros(seen.robot.n), seen.robot.B_m[:, best.fault.joint])
    acted = (y + seen.means(seen.u[:, best.fault.joint])[:, None] * B / seen.sigma)[:, B != 0]
    left = best.left - float((y[:, B == 0] ** 2).sum())
    return left < max(PRESENT**2 * acted.size, (1 - EXPLAINED) * float((acted**2).sum()))


def at_one_place(seen: Residuals, names: Sequence[str]) -> Finding | None:
    """Return the finding that torques of no known kind act at one joint; None if no place explains the residual.

    An unknown torque in each block acts on a link, on a motor, or on both with opposite signs, as a spring does. It
    takes the residual along its direction, (sigma^-1 times the signs) of unit length, whatever the torque is.
    """
    n, y = seen.robot.n, seen.r / seen.sigma
    signs = np.vstack([np.eye(2 * n), np.eye(n, 2 * n) - np.eye(n, 2 * n, n)])
    directions = signs / seen.sigma[:, None]  # of each block
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    left = float((y**2).sum()) - (np.einsum("bi,bpi->bp", y, directions) ** 2).sum(axis=0)
    of_noise = (seen.noise / seen.sigma) ** 2
    best, total, noise = int(np.argmin(left)), float((y**2).sum()), float(of_noise.sum())
    share = explained_share(left[best] - noise + float((directions[:, best] ** 2 * of_noise).sum()), total - noise)
    others = left[np.arange(3 * n) % n != best % n]
    if share < EXPLAINED or not all(_clearly(left[best], each, y.size) for each in others):
        return None
    joint, side = names[best % n], (LINK, MOTOR, JOINT)[best // n]
    what = f"{joint if side == JOINT else f'{side} of {joint}'}: torques of no known kind of fault"
    said = f"{what} explain {percent(share, 0)} of the residual torque"
    return Finding(UNKNOWN, joint, side, share=share, sentence=said)


def external_torque(seen: Residuals, names: Sequence[str]) -> Finding | None:
    """Return the finding that torques act on links for part of the time; None if they do not, or motors need some, too.

    It names the joints whose torque is not NEGLIGIBLE; how large they were, report.contact says. A fault of the robot
    acts all the time while it moves, and friction, which may act at low speed only, never drives a joint.
    """
    size, n = np.abs(seen.r), seen.robot.n
    largest = size.max(axis=0)
    on_l = largest[:n]
    significant = size[:, :n] > SIGNIFICANT * seen.sigma[:, :n]
    felt = significant.any(axis=0) & (on_l > NEGLIGIBLE * on_l.max())
    acting = significant & (size[:, :n] > QUIET * on_l)
    often = float((acting & felt).any(axis=1).mean())
    power = (seen.r * seen.means(seen.dq))[:, :n]
    driven = np.maximum(power, 0.0).sum(axis=0) > DRIVEN * np.abs(power).sum(axis=0)
    pairs = acting[1:] & acting[:-1]
    turned = (pairs & (np.diff(np.sign(seen.r[:, :n]), axis=0) != 0)).sum(axis=0)
    driven &= turned <= SWINGS * pairs.sum(axis=0)
    if not (felt & driven).any() or often > EPISODE or largest[n:].max() > REACTION * on_l.max():
        return None
    concerned = ", ".join(names[j] for j in np.flatnonzero(felt))
    share = float((size[:, :n] ** 2).sum() / (size**2).sum())
    return Finding(EXTERNAL, concerned, LINK, share=share, sentence=f"{EXTERNAL} on {concerned}")


def unexplained(nearest: FittedFault, share: float, names: Sequence[str]) -> Finding:
    """Return the finding that no fault explains the residual torque, of which the nearest one explains a share."""
    sentence = "no single fault explains the residual torque"
    if share >= NEAREST:
        sentence += f"; the nearest, {nearest.kind} ({nearest.fault.place(names)}), explains {percent(share, 0)}"
    return Finding(UNKNOWN, "", share=share, sentence=sentence)
