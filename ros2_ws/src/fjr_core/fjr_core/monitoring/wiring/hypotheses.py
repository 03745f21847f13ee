# SPDX-License-Identifier: Apache-2.0
"""Hypotheses on the wiring, each with the correction that undoes it in measured samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array

Order = NDArray[np.intp]


@dataclass(frozen=True, order=True)
class WiringFault:
    """Fault of the wiring.

    kind: "effort sign", "efforts exchanged", "encoder sign", "encoders exchanged", "velocity sign" or "velocity of
    another joint". joints: indices, two if joints are exchanged. side: "link" or "motor".
    """

    kind: str
    joints: tuple[int, ...]
    side: str

    def sentence(self, names: tuple[str, ...] | list[str]) -> str:
        """Describe the fault with the names of the joints."""
        named = " and ".join(names[j] for j in self.joints)
        other = names[self.joints[-1]]
        return {
            "effort sign": f"the effort of {named} acts with the wrong sign",
            "efforts exchanged": f"the efforts of {named} are exchanged",
            "encoder sign": f"the {self.side} encoder of {named} has the wrong sign",
            "encoders exchanged": f"the {self.side} encoders of {named} are exchanged",
            "velocity sign": f"the {self.side} velocity of {named} has the sign opposite to its position's slope",
            "velocity of another joint": f"the {self.side} velocity of {names[self.joints[0]]} is that of {other}",
        }[self.kind]


@dataclass(frozen=True)
class Window:
    """m samples: t (m,) [s]; q, dq (m, 2n): links, then motors; u (m, n) [N m]: command for each sample."""

    t: Array
    q: Array
    dq: Array
    u: Array


Undone = Callable[[Window], Window]


def hypotheses(encoders: set[int], motors: set[int], n: int) -> Iterator[tuple[WiringFault, Undone]]:
    """Return the possible faults of suspected joints, each with the correction that undoes it."""
    none, same, same_encoders = np.ones(2 * n), np.arange(n), np.arange(2 * n)
    for j in sorted(motors):
        yield WiringFault("effort sign", (j,), "motor"), _effort(same, _signs(n, j))
    if len(motors) > 1:
        signs = np.where(np.isin(same, sorted(motors)), -1.0, 1.0)
        yield WiringFault("effort sign", tuple(sorted(motors)), "motor"), _effort(same, signs)
    for i, j in combinations(sorted(motors), 2):
        yield WiringFault("efforts exchanged", (i, j), "motor"), _effort(_order(n, i, j), none[:n])
    for side, name in ((0, "link"), (n, "motor")):
        for j in sorted(encoders):
            yield WiringFault("encoder sign", (j,), name), _encoders(same_encoders, _signs(2 * n, side + j))
        for i, j in combinations(sorted(encoders), 2):
            yield WiringFault("encoders exchanged", (i, j), name), _encoders(_order(2 * n, side + i, side + j), none)


def _effort(order: Order, signs: Array) -> Undone:
    return lambda w: Window(w.t, w.q, w.dq, (w.u * signs)[:, order])


def _encoders(order: Order, signs: Array) -> Undone:
    return lambda w: Window(w.t, (w.q * signs)[:, order], (w.dq * signs)[:, order], w.u)


def _signs(size: int, at: int) -> Array:
    return np.where(np.arange(size) == at, -1.0, 1.0)


def _order(size: int, one: int, other: int) -> Order:
    order = np.arange(size)
    order[[one, other]] = order[[other, one]]
    return order
