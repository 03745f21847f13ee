# SPDX-License-Identifier: Apache-2.0
"""Evaluate the certificate and the innovations online, one state at a time, by the control step in C."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import StateError
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, Prediction
from fjr_core.monitoring.thresholds import LONGEST
from fjr_core.motions.reference import JETS
from fjr_core.numerics.c_library import record_type
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import NEVER
from fjr_core.runtime.library import StepLibrary, step_library
from fjr_core.runtime.structs import CertificateStruct

from .innovations import Innovations

_FIELDS = {name: name for name in ("dt", "V0", "predicted", "sent", "law", "older", "error", "slope")} | {"V1": "V"}
"""Fields of Innovations, with the names of struct fjr_certified."""
CAPACITY = 640  # intervals; at least the latest half is kept


class OnlineCertificate:
    """Certificate of the latest state and innovations of the latest intervals; not thread-safe.

    `certify` evaluates fjr_certify of step.h, as the hosts in C do; without machine code of the law it calls Python.
    position (2n,) [rad], jets (5, n): latest state and reference. records: certified, command (1,), the structures of
    the latest state, by their names. Raises CompilerError without a C compiler.
    """

    def __init__(self, law: TrackingLaw, library: StepLibrary | None = None) -> None:
        """library: the control step of the law with its robust action; None: that without."""
        self._n, self._library = law.robot.n, library or step_library(law.robot.n)
        certificate, prediction = Certificate(law), Prediction(law)
        self.functions = {
            "certify": certificate.function,
            "predict": prediction.function,
            "law": law.measured_function,
        }
        """Functions of struct fjr_certificate by name."""
        ffi = self._library.ffi
        self.struct = CertificateStruct(ffi, self.functions, law, LONGEST)
        self._pointers, self.records = {}, {}
        for name in ("certified", "command"):
            self.records[name] = made = np.zeros(1, record_type(ffi, ffi.typeof(f"struct fjr_{name}")))
            self._pointers[name] = ffi.from_buffer(f"struct fjr_{name}[]", made.view(np.uint8))
        command = self.records["command"]
        self.position, self._velocity, self._u = (command[name][0] for name in ("position", "velocity", "u"))
        self.jets = command["jets"].reshape(JETS, self._n)
        self._kept: NDArray[Any] = np.zeros(CAPACITY, self.records["certified"].dtype)
        self._latencies, self._tracking, self._latency = np.zeros(CAPACITY), np.zeros((CAPACITY, self._n)), 0.0
        self.use(law)

    def use(self, law: TrackingLaw) -> None:
        """Use a law made by `with_gains`; discard the intervals and start the bound on V again."""
        self.struct.pointer.gains = self.struct.keep(law)
        self.forget()

    def forget(self) -> None:
        """Discard the intervals; the next state has no predecessor."""
        self.count = 0
        self.restart()

    def restart(self) -> None:
        """Let the next state have no predecessor, and start the bound on V again."""
        self._library.lib.fjr_certificate_restart(self.struct.pointer)

    def certify(
        self,
        stamp: int,
        position: Array,
        velocity: Array,
        jets: Array,
        u: Array,
        bound_start: int | None = None,
        restarted: bool = False,
    ) -> Any:
        """Evaluate the certificate of the next state, its reference and its command; return struct fjr_certified.

        stamp [ns]; position, velocity (2n,), jets (5, n), u (n,) [N m]. bound_start [ns]: stamp from which the bound on
        V holds; None: no bound. restarted: it has no predecessor. The result is valid until the next state. Raises
        StateError if a function has no result.
        """
        self.position[:], self._velocity[:], self.jets[:], self._u[:] = position, velocity, jets, u
        command, found = self._pointers["command"][0], self._pointers["certified"]
        command.bound_start, command.restarted = NEVER if bound_start is None else bound_start, restarted
        if not self._library.lib.fjr_certify(self.struct.pointer, self._pointers["command"], stamp, found):
            raise StateError(f"the certificate of the state at {stamp} ns cannot be evaluated; expected a finite state")
        return found[0]

    def take(self, stamp: int, position: Array, velocity: Array, jets: Array, u: Array, latency: float = 0.0) -> Any:
        """Certify the next state and append it; latency [s]: delay of its command, 0: not known."""
        found = self.certify(stamp, position, velocity, jets, u)
        self.append(**self.records, latency=np.array([latency]))
        return found

    def append(self, certified: NDArray[Any], command: NDArray[Any], latency: Array) -> int:
        """Append the intervals that end at k states, at most CAPACITY / 2; return the number of intervals.

        certified, command (k,): struct fjr_certified and fjr_command of each state; a state that does not follow
        another one ends no interval. latency (k,) [s]: of these commands.
        """
        n, before = self._n, np.append(self._latency, latency[:-1])
        rows: NDArray[np.bool_] = certified["follows"] != 0
        new = int(np.count_nonzero(rows))
        self._latency = float(latency[-1])
        np.copyto(self.position, command["position"][-1])
        np.copyto(self.jets, command["jets"][-1].reshape(self.jets.shape))
        if not new:
            return 0
        if self.count + new > CAPACITY:
            self._drop_oldest()
        to, plain = slice(self.count, self.count + new), np.dtype((np.void, certified.itemsize))
        self._kept.view(plain)[to] = certified.view(plain)[rows]  # bytes: to copy field by field is slow
        self._latencies[to] = np.minimum(before[rows] / certified["dt"][rows], 1.0)
        self._tracking[to] = command["position"][rows, :n] - command["jets"][rows, :n]
        self.count += new
        return new

    def last(self, count: int, before: int = 0) -> Innovations:
        """Return at most the last `count` intervals, without the `before` latest ones."""
        end = self.count - before
        rows = slice(max(0, end - count), end)
        found = {name: np.ascontiguousarray(self._kept[field][rows]) for name, field in _FIELDS.items()}
        k = len(found["dt"])
        unmeasured = {name: np.full((k, self._n), np.nan) for name in ("before", "after")}
        own = {"latency": self._latencies[rows].copy(), "tracking": self._tracking[rows].copy()}
        return Innovations(**found, **unmeasured, **own, answered=np.ones(k, dtype=bool))

    def _drop_oldest(self) -> None:
        """Keep the latest half of the capacity."""
        half = CAPACITY // 2
        for kept in (self._kept, self._latencies, self._tracking):
            kept[:half] = kept[self.count - half : self.count].copy()
        self.count = half
