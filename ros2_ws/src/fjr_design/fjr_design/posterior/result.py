# SPDX-License-Identifier: Apache-2.0
"""What was identified: each parameter with its interval and verdict, and the posterior of all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fjr_core.numerics.checks import Array

IDENTIFIED, WEAK, UNKNOWN = "identified", "weakly identified", "not identifiable"
LOG, NONNEGATIVE, LINEAR = "log", "non-negative", "linear"
"""Coordinates of a parameter in the posterior: its logarithm, or the parameter, whose draws may be clipped at 0."""
DEFLECTION = "deflection"
"""Signal q_m - q_l of a fit that follows from the motion."""


def natural(z: Array, coordinate: str) -> Array:
    """Return parameter values of their coordinates."""
    if coordinate == LOG:
        return np.exp(z)
    return np.maximum(z, 0.0) if coordinate == NONNEGATIVE else z


@dataclass(frozen=True)
class Estimate:
    """One parameter of one joint: value, 95 % interval (low, high), prior value, verdict and its reason.

    name: joint_stiffness [N m/rad], motor_inertia [kg m^2], link_damping, motor_damping [N m s/rad],
    link_coulomb_friction, motor_coulomb_friction, link_static_friction, motor_static_friction [N m], offset [rad] (of
    q_m - q_l at zero spring torque), link_skew, motor_skew, torque_skew, effort_delay [s], payload_mass [kg],
    payload_position_x, _y, _z [m], position_torque_sin1, _cos1, _sin2, _cos2 [N m]. joint: its joint, or "" for the
    whole arm. An UNKNOWN parameter keeps its prior; reason says which motion would reveal it.
    """

    name: str
    joint: str
    unit: str
    value: float
    low: float
    high: float
    prior: float
    verdict: str
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Fit:
    """Measured and predicted signals of one record by name, `q_l`, `q_m`, `torque` or DEFLECTION, each (k, n).

    DEFLECTION [rad]: of a record that is not simulated, from its filtered motion, less its mean. noise (n,): standard
    deviation of the measurement of each joint; of DEFLECTION the root mean square residual. explained (n,): share of
    the deflection's variance that the model explains, NaN where there is no link measurement.
    """

    record: str
    t: Array
    measured: Mapping[str, Array]
    predicted: Mapping[str, Array]
    noise: Mapping[str, Array]
    explained: Array


@dataclass(frozen=True, eq=False)
class Identification:
    """Estimates of all parameters, and the posterior of those that are not UNKNOWN.

    coordinates: LOG, NONNEGATIVE or LINEAR per entry of the posterior; free: index into `estimates` of each entry. mean
    (p,) and covariance (p, p) are in these coordinates.
    """

    joints: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    free: tuple[int, ...]
    coordinates: tuple[str, ...]
    mean: Array
    covariance: Array
    fits: tuple[Fit, ...] = ()

    def value(self, name: str) -> Array:
        """Return the values of a parameter for all joints that have it, in their order."""
        return np.array([each.value for each in self.estimates if each.name == name])

    def draws(self, count: int, seed: int) -> Array:
        """Return draws (count, len(estimates)) of all parameters from the posterior; UNKNOWN ones keep their prior."""
        return self.at(np.random.default_rng(seed).standard_normal((count, len(self.mean))))

    def at(self, normal: Array) -> Array:
        """Return draws (k, len(estimates)) at standard normal numbers (k, p), by the symmetric root of covariance."""
        w, v = np.linalg.eigh(self.covariance)
        z = self.mean + normal @ (v * np.sqrt(np.maximum(w, 0.0))) @ v.T
        drawn = np.tile([each.value for each in self.estimates], (len(normal), 1))
        for k, (index, coordinate) in enumerate(zip(self.free, self.coordinates, strict=True)):
            drawn[:, index] = natural(z[:, k], coordinate)
        return drawn

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for identification.json; from_dict makes the same identification, without fits."""
        return {
            "joints": list(self.joints),
            "estimates": [asdict(each) for each in self.estimates],
            "free": list(self.free),
            "coordinates": list(self.coordinates),
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Identification:
        """Return the identification of `as_dict`."""
        return cls(
            tuple(values["joints"]),
            tuple(Estimate(**each) for each in values["estimates"]),
            tuple(values["free"]),
            tuple(values["coordinates"]),
            np.array(values["mean"], dtype=float),
            np.array(values["covariance"], dtype=float).reshape(len(values["mean"]), -1),
        )
