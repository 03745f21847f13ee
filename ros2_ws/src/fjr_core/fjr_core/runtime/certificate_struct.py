# SPDX-License-Identifier: Apache-2.0
"""struct fjr_certificate of step.h for a v-dPBC law, with the memory that it points to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from ..law.vdpbc import TrackingLaw
from ..numerics.checks import Array
from .c_function import CFunction, WorkSpace


class CertificateStruct:
    """The certificate of a law; `pointer` is a struct fjr_certificate*, valid as long as this object lives.

    ffi: with the types of step.h. functions: certify, predict and law, machine code or not. longest [s]: between two
    samples that are compared.
    """

    def __init__(self, ffi: Any, functions: Mapping[str, ca.Function], law: TrackingLaw, longest: float) -> None:
        self._held = {name: CFunction(ffi, function) for name, function in functions.items()}
        self._work, self._ffi = WorkSpace(ffi, list(functions.values())), ffi
        self.pointer = ffi.new("struct fjr_certificate *")
        for name, function in self._held.items():
            setattr(self.pointer, name, function.pointer)
        self._work.lend(self.pointer)
        self.pointer.B_m = np.ravel(law.robot.B_m).tolist()
        self.pointer.longest, self.pointer.bounded = longest, True
        self._gains: Array | None = None

    def keep(self, law: TrackingLaw) -> Any:
        """Return the gains of a law for C; those before are released by the next call."""
        self._before, self._gains = self._gains, np.ascontiguousarray(law.gain_values, dtype=float)
        return self._ffi.from_buffer("double[]", self._gains)
