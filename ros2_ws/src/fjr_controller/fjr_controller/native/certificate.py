# SPDX-License-Identifier: Apache-2.0
"""The certificate of each sample, evaluated by the native thread (certificate.h); Python diagnoses its records."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw
from fjr_core.control_step.c_function import CFunction, WorkSpace
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr.layout import float_array
from fjr_msgs_py.messages.certificate import LABELS
from fjr_msgs_py.native.entities import NativeMessage
from fjr_msgs_py.native.program import Program

from ..ros.certificate_diagnosis import LONGEST, CertificateDiagnosis

BATCH = 64  # records; fewer than half of those that the diagnosis keeps


class NativeCertificate:
    """The sibling of CertificatePublisher for the native loop; `pointer` is a struct fjr_certificate*."""

    def __init__(self, node: Node, program: Program, diagnosis: CertificateDiagnosis) -> None:
        """Create the publisher and the structures; the law and its certificate must be compiled."""
        self._node, self._diagnosis = node, diagnosis
        self.publisher = node.create_publisher(Float64MultiArray, names.CERTIFICATE, names.sample_qos(node))
        self.message = NativeMessage(program, float_array(",".join(LABELS), len(LABELS)), (len(LABELS),))
        ffi, law, online = program.ffi, diagnosis.law, diagnosis.online_certificate
        functions = dict(zip(("certify", "predict"), online.functions, strict=True), law=law.measured_function)
        self._held = {name: CFunction(ffi, function) for name, function in functions.items()}
        self._work, self._ffi = WorkSpace(ffi, list(functions.values())), ffi
        self._gains: Array | None = None
        self.pointer = ffi.new("struct fjr_certificate*")
        for name, function in self._held.items():
            setattr(self.pointer, name, function.pointer)
        for name in ("arg", "res", "iw", "w"):
            setattr(self.pointer, name, getattr(self._work, name))
        self.pointer.B_m = np.ravel(law.robot.B_m).tolist()
        self.pointer.longest, self.pointer.bounded = LONGEST, not diagnosis.no_diagnosis
        self.request: Callable[[Any, Any], None] = lambda gains, beta: None
        """Let the thread use other gains and another beta; set by the loop."""

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Replace the law by one made by `with_gains`, and the effort limits (n,) [N m]; the bound starts again."""
        self._diagnosis.use(law, limit)
        self.restart()

    def restart(self) -> None:
        """Hand gains and beta of the present law to the thread."""
        gains = np.ascontiguousarray(self._diagnosis.law.gain_values, dtype=float)
        self.request(self._ffi.from_buffer("double[]", gains), self._ffi.new("double*", self._diagnosis.beta))
        self._gains = gains  # the thread no longer reads those before

    def status(self) -> DiagnosticStatus:
        """Return the diagnosis of the last second."""
        found = self._diagnosis.status()
        self.pointer.beta = self._diagnosis.beta
        return found

    def on_records(self, records: NDArray[Any]) -> None:
        """Add the certificates of some records of the queue to the diagnosis."""
        for start in range(0, len(records), BATCH):
            batch = records[start : start + BATCH]
            times = (batch["sample"]["stamp"], batch["arrival"], batch["sent"], batch["certified"]["follows"])
            latencies = [self._diagnosis.latency(*row) for row in zip(*(each.tolist() for each in times), strict=True)]
            online = self._diagnosis.online_certificate
            self._diagnosis.look(online.append(batch["certified"], batch["command"], np.array(latencies)))

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self.publisher)
