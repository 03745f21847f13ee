# SPDX-License-Identifier: Apache-2.0
"""A baseline with an observer of its own: u(x, x, t) with exact estimates, and the law as it is run."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from types import SimpleNamespace

import casadi as ca
import numpy as np

from fjr_core.law.interfaces import step_symbols
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import PackedVector, dense_function
from fjr_core.robust.law import Robust, RobustLaw

from .baseline import Baseline


class ObservedBaseline(Baseline):
    """A baseline that estimates torques. As a static law, the estimates are those of the exact model.

    memory_sizes: sizes of the parts of the observer's state by name.
    """

    memory_sizes: Mapping[str, int]

    @abstractmethod
    def observe(
        self, kept: SimpleNamespace, s: SimpleNamespace, g: SimpleNamespace
    ) -> tuple[ca.SX, ca.SX, dict[str, ca.SX]]:
        """Return u (n,) [N m], V [J] and the next memory.

        kept: memory, not yet set at the first sample, where s.dt = 0. s: symbols of interfaces.ARGUMENTS. g: gains.
        """

    @property
    def sampled(self) -> ObservedLaw:
        """The law with its observer."""
        return ObservedLaw(self, Robust())


class ObservedLaw(RobustLaw):
    """A baseline with its observer, as a SampledLaw; the robust action is off."""

    law: ObservedBaseline

    @property
    def memory(self) -> Array:
        """Initial state of the observer: zeros, set by the first sample."""
        return np.zeros(PackedVector(self.law.memory_sizes).size)

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function."""
        law, packed = self.law, PackedVector(self.law.memory_sizes)
        s = {name: ca.SX.sym(name, *symbol.shape) for name, symbol in step_symbols(self).items()}
        s["gains"] = law.symbols.vector
        given = packed.named(s["memory"]), SimpleNamespace(**s), SimpleNamespace(**law.symbols.by_name)
        u, V, kept = law.observe(*given)
        return dense_function("observed_law", s, {"u": u, "V": V, "next": packed.pack(kept)}, cse=True)
