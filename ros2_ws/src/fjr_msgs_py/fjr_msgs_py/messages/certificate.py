# SPDX-License-Identifier: Apache-2.0
"""Certificates as labelled arrays; the stamp comes first because the message type has no header."""

from __future__ import annotations

from typing import NamedTuple

from std_msgs.msg import Float64MultiArray

from .cdr.layout import Template, float_array

SECOND = 1_000_000_000


class CertificateValues(NamedTuple):
    """Storage function and energy at one state.

    V [J]: storage function of the law. dV_predicted [W]: dV/dt of the model under the effort sent.
    dV_measured [W]: mean dV/dt since the last state. bound [J]: continuous-time bound of V, -1 while the law does not
    determine the effort. H [J]: energy of the robot, with dH/dt = supplied - dissipated [W].
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
    """Writer of certificates: one serialised Float64MultiArray of LABELS, reused."""

    def __init__(self) -> None:
        self._template = Template(float_array(",".join(LABELS), len(LABELS)), [len(LABELS)])

    def fill(self, stamp: int, values: CertificateValues) -> bytes:
        """Return the serialised message of the state with this stamp [ns]."""
        self._template.fields[0][:] = (*divmod(stamp, SECOND), *values)
        return self._template.serialised()


def labelled(message: Float64MultiArray) -> dict[str, float]:
    """Return the numbers of an array by label; empty if their labels are incomplete.

    The labels are one per dimension, or separated by commas in a single dimension.
    """
    labels = [dimension.label for dimension in message.layout.dim]
    if len(labels) == 1:
        labels = labels[0].split(",")
    if len(labels) != len(message.data) or not all(labels):
        return {}
    return {label.strip(): float(value) for label, value in zip(labels, message.data, strict=True)}
