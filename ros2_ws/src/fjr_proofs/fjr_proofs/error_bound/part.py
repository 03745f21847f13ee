# SPDX-License-Identifier: Apache-2.0
"""Part of a box of factors with its centre motion and the tube about it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array

from .centre_motion import CentreMotion

NARROWEST = 0.002
"""Width of a factor that is not divided."""


@dataclass(frozen=True, eq=False)
class Part:
    """Part of the box of factors, low to high (7,).

    centre: of the robot in the middle; the reference itself if the loop is unstable or has no period. effect:
    deviation of a position [rad] by each uncertain factor. first_order, ultimate, from_start (2n,): bounds of |q_l -
    q_ld| and |dq_l - dq_ld|: by the known response to the factors alone; in the steady state; at all times for a
    robot that starts on the reference. The latter two are infinite without a tube. storage: largest V [J] in the
    steady state; nan if the law has none. share: width of parts of this one that have a tube, relative to it.
    """

    low: Array
    high: Array
    centre: CentreMotion
    effect: Array
    first_order: Array
    ultimate: Array
    from_start: Array
    storage: float = np.inf
    share: float = 0.5

    @property
    def found(self) -> bool:
        """True if the part has a tube."""
        return bool(np.all(np.isfinite(self.ultimate)))

    @property
    def size(self) -> float:
        """Largest bound of a position; infinite without a tube."""
        return float(np.max(np.split(self.ultimate, 2)[0]))

    @property
    def excess(self) -> float:
        """Ratio of the bound of the positions to that to first order in the factors; infinite without a tube."""
        found, least = (np.split(each, 2)[0] for each in (self.ultimate, self.first_order))
        return float(np.max(found / np.maximum(least, 1e-12)))

    @property
    def narrow(self) -> bool:
        """True if no factor can be divided."""
        return bool(np.all(self.high - self.low <= NARROWEST))

    def of(self, low: Array, high: Array) -> float:
        """Return the share of this part in the volume of a box of factors."""
        width = high - low
        return float(np.prod(np.divide(self.high - self.low, width, out=np.ones_like(width), where=width > 0)))

    def counts(self) -> NDArray[np.intp]:
        """Return into how many (7,) the factors are divided, so that their effect is at most `share` of that here.

        The factor with the largest effect in a box is divided first; without any effect the widest factor is halved.
        """
        width = self.high - self.low
        effect, count = np.zeros_like(width), np.ones(len(width), dtype=np.intp)
        effect[width > 0] = self.effect
        while np.sum(effect / count) > self.share * np.sum(effect) and np.any(width / count > NARROWEST):
            count[np.argmax(np.where(width / count > NARROWEST, effect / count, -1.0))] += 1
        if np.all(count == 1):
            count[np.argmax(width)] = 2
        return count

    def divided(self, counts: NDArray[np.intp]) -> list[tuple[Array, Array]]:
        """Return boxes of equal size, of which `counts` (7,) are beside each other for each factor."""
        width = (self.high - self.low) / counts
        places = map(np.array, product(*(range(each) for each in counts)))
        return [
            (self.low + width * i, np.where(i + 1 == counts, self.high, self.low + width * (i + 1))) for i in places
        ]
