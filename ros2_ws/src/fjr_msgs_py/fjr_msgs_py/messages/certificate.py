# SPDX-License-Identifier: Apache-2.0
"""Certificates as messages: numbers with labels, the stamp first, as the type has no header."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from std_msgs.msg import Float64MultiArray

from .cdr.layout import Template, float_array
from .joint_states import MessageError

SECOND = 1_000_000_000


class CertificateValues(NamedTuple):
    """The theory against the measurement at one state.

    V [J]: the law's storage. dV_predicted [W]: its exact rate under the effort sent. dV_measured [W]: its mean rate
    since the last state. bound [J]: what V may be at most in continuous time, -1 while the effort is not the law's.
    H [J]: the robot's energy. supplied, dissipated [W]: dH/dt = supplied - dissipated.
    """

    V: float
    dV_predicted: float
    dV_measured: float
    bound: float
    H: float
    supplied: float
    dissipated: float


LABELS = ("sec", "nanosec", *CertificateValues._fields)


class CertificateWriter:
    """A serialised Float64MultiArray of LABELS, filled again and again."""

    def __init__(self) -> None:
        self._template = Template(float_array(",".join(LABELS), len(LABELS)), [len(LABELS)])

    def fill(self, stamp: int, values: CertificateValues) -> bytes:
        """The message of the state with this stamp [ns], for a publisher."""
        self._template.fields[0][:] = (*divmod(stamp, SECOND), *values)
        return self._template.serialised()


def read_certificate(message: Float64MultiArray) -> tuple[int, CertificateValues]:
    """Stamp [ns] and values, found by their labels in any order; raises MessageError for anything else."""
    labels = [label for dimension in message.layout.dim for label in dimension.label.split(",")]
    missing = [label for label in LABELS if label not in labels]
    if missing or len(labels) != len(message.data):
        raise MessageError("no certificate", f"labels are {labels}; expected {', '.join(LABELS)}, one for each number")
    numbers = dict(zip(labels, np.asarray(message.data, dtype=float).tolist(), strict=True))
    stamp = round(numbers["sec"]) * SECOND + round(numbers["nanosec"])
    return stamp, CertificateValues(*(numbers[name] for name in CertificateValues._fields))


def labelled(message: Float64MultiArray) -> dict[str, float]:
    """Numbers by label: one dimension for each, or one for all with commas between its labels; empty without labels."""
    labels = [dimension.label for dimension in message.layout.dim]
    if len(labels) == 1:
        labels = labels[0].split(",")
    if len(labels) != len(message.data) or not all(labels):
        return {}
    return {label.strip(): float(value) for label, value in zip(labels, message.data, strict=True)}
