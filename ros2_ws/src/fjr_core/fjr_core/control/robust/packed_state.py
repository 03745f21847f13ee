# SPDX-License-Identifier: Apache-2.0
"""What a sampled law keeps from sample to sample: named parts of one vector."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np


class Parts:
    """Names and sizes of the parts of a vector, one after another."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.sizes = dict(sizes)
        self.size = sum(self.sizes.values())

    def split(self, vector: ca.MX) -> dict[str, ca.MX]:
        """The parts of the vector (size,) by their names."""
        if not self.sizes:
            return {}
        ends = np.cumsum([0, *self.sizes.values()]).tolist()
        return dict(zip(self.sizes, ca.vertsplit(vector, ends), strict=True))

    def join(self, parts: Mapping[str, ca.MX]) -> ca.MX:
        """The vector (size,) of the parts."""
        return ca.vertcat(*(parts[name] for name in self.sizes))
