# SPDX-License-Identifier: Apache-2.0
"""Pack named parts of a controller state or a gain set into one vector."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace

import casadi as ca
import numpy as np


class PackedVector:
    """Names and sizes of the consecutive parts of a vector."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.sizes = dict(sizes)
        self.size = sum(self.sizes.values())

    def unpack(self, vector: ca.MX) -> dict[str, ca.MX]:
        """Return the parts of the vector (size,) by name."""
        if not self.sizes:
            return {}
        ends = np.cumsum([0, *self.sizes.values()]).tolist()
        return dict(zip(self.sizes, ca.vertsplit(vector, ends), strict=True))

    def named(self, vector: ca.SX) -> SimpleNamespace:
        """Return the parts of the vector (size,) as attributes."""
        return SimpleNamespace(**self.unpack(vector))

    def pack(self, parts: Mapping[str, ca.MX]) -> ca.MX:
        """Return the vector (size,) of the parts."""
        return ca.vertcat(*(parts[name] for name in self.sizes))
