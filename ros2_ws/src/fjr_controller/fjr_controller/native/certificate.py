# SPDX-License-Identifier: Apache-2.0
"""The certificate of each sample, evaluated by the native thread (step.h); Python diagnoses its records."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw
from fjr_core.monitoring.thresholds import LONGEST
from fjr_core.numerics.checks import Array
from fjr_core.runtime.certificate_struct import CertificateStruct
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr.layout import float_array
from fjr_msgs_py.messages.certificate import LABELS
from fjr_msgs_py.native.entities import NativeMessage
from fjr_msgs_py.native.program import Program

from ..ros.certificate_diagnosis import CertificateDiagnosis

BATCH = 64  # records; fewer than half of those that the diagnosis keeps


class NativeCertificate:
    """The sibling of CertificatePublisher for the native loop; `pointer` is a struct fjr_certificate*."""

    def __init__(self, node: Node, program: Program, diagnosis: CertificateDiagnosis) -> None:
        """Create the publisher and the structures; the law and its certificate must be compiled."""
        self._node, self._diagnosis = node, diagnosis
        self.publisher = node.create_publisher(Float64MultiArray, names.CERTIFICATE, names.sample_qos(node))
        self.message = NativeMessage(program, float_array(",".join(LABELS), len(LABELS)), (len(LABELS),))
        functions, self._ffi = diagnosis.online_certificate.functions, program.ffi
        self._struct = CertificateStruct(program.ffi, functions, diagnosis.law, LONGEST)
        self.pointer = self._struct.pointer
        self.pointer.bounded = not diagnosis.no_diagnosis
        self.request: Callable[[Any, Any], None] = lambda gains, beta: None
        """Let the thread use other gains and another beta; set by the loop."""

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Replace the law by one made by `with_gains`, and the effort limits (n,) [N m]; the bound starts again."""
        self._diagnosis.use(law, limit)
        self.restart()

    def restart(self) -> None:
        """Hand gains and beta of the present law to the thread."""
        self.request(self._struct.keep(self._diagnosis.law), self._ffi.new("double*", self._diagnosis.beta))

    def status(self) -> DiagnosticStatus:
        """Return the diagnosis of the last second."""
        found = self._diagnosis.status()
        self.pointer.beta = self._diagnosis.beta
        return found

    def on_records(self, records: NDArray[Any]) -> None:
        """Add the certificates of some records of the queue to the diagnosis."""
        for start in range(0, len(records), BATCH):
            batch = records[start : start + BATCH]
            columns = (batch["sample"]["stamp"], batch["arrival"], batch["sent"])
            times = list(zip(*(column.tolist() for column in columns), strict=True))
            self._diagnosis.add(times, batch["certified"], batch["command"])

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self.publisher)
