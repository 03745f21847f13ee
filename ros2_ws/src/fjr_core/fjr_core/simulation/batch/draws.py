# SPDX-License-Identifier: Apache-2.0
"""Drawn parameters of k runs: deviations of robot, sensors and loop from the nominal ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ParameterError
from ...numerics.checks import Array, floats, freeze

PER_RUN = ("delay", "position_noise", "velocity_noise", "resolution", "payload_mass", "smoothing")
"""Parameters with one number per run; the others may differ between joints."""
POSITIVE = ("stiffness", "link_inertia", "motor_inertia", "smoothing", "effort_limit")
SMOOTHING = 0.01  # rad/s
UNITS = {
    "coulomb_l": "N m",
    "coulomb_m": "N m",
    "smoothing": "rad/s",
    "external": "N m",
    "payload_mass": "kg",
    "payload_position": "m",
    "delay": "s",
    "position_noise": "rad",
    "velocity_noise": "rad/s",
    "resolution": "rad",
    "effort_limit": "N m",
}
"""Units of levels; the other fields are factors."""
SIGNED = ("gravity", "external", "payload_position")


@dataclass(frozen=True, eq=False)
class Draws:
    """Parameters of k runs. Each field is a scalar for all runs, (k,), or (k, n) per joint; nominal by default.

    Factors on plant parameters: stiffness, link_inertia, gravity, motor_inertia, link_damping, motor_damping (see
    uncertain_robot for matrices; damping may be 0, gravity of either sign). Levels: coulomb_l, coulomb_m [N m]: Coulomb
    friction of links and motors, times tanh(v / smoothing); smoothing [rad/s] (k,); external [N m]: constant torque on
    the links;
    payload_mass [kg] (k,) at payload_position (3,) or (k, 3) [m] in the frame of the last link; delay [s] (k,) from a
    sample to its effort, any fraction of the sample period; position_noise [rad] and velocity_noise [rad/s] (k,):
    standard deviations of white noise; resolution [rad] (k,) of the encoders, 0: exact; effort_limit [N m]: saturation
    of the command, known to the law. seed (k,) uint64: of the noise; default: number of the run. Raises ParameterError.
    """

    runs: int
    stiffness: ArrayLike = 1.0
    link_inertia: ArrayLike = 1.0
    gravity: ArrayLike = 1.0
    motor_inertia: ArrayLike = 1.0
    link_damping: ArrayLike = 1.0
    motor_damping: ArrayLike = 1.0
    coulomb_l: ArrayLike = 0.0
    coulomb_m: ArrayLike = 0.0
    smoothing: ArrayLike = SMOOTHING
    external: ArrayLike = 0.0
    payload_mass: ArrayLike = 0.0
    payload_position: ArrayLike = 0.0
    delay: ArrayLike = 0.0
    position_noise: ArrayLike = 0.0
    velocity_noise: ArrayLike = 0.0
    resolution: ArrayLike = 0.0
    effort_limit: ArrayLike = np.inf
    seed: ArrayLike | None = None

    def __post_init__(self) -> None:
        if isinstance(self.runs, bool) or not isinstance(self.runs, (int, np.integer)) or self.runs < 0:
            raise ParameterError(f"runs is {self.runs!r}; expected a whole number, 0 or more")
        for name in LEVELS:
            freeze(self, name, self._checked(name))
        freeze(self, "seed", self._seeds())

    def columns(self, name: str, n: int) -> Array:
        """Return one field as (k, n), as (k, 1) if it is PER_RUN, or as (k, 3) for payload_position."""
        value, most = np.asarray(getattr(self, name)), 1 if name in PER_RUN else width(name, n)
        each = value.shape == (self.runs,) and name != "payload_position"  # a list of it is always x, y, z
        column = value[:, None] if each else value
        if column.ndim and column.shape[-1] not in (1, most):
            raise ParameterError(
                f"{name} has shape {value.shape}; expected a scalar, ({self.runs},) or {(self.runs, most)}"
            )
        return np.ascontiguousarray(np.broadcast_to(column, (self.runs, most)))

    def taken(self, which: slice | Iterable[int]) -> Draws:
        """Return the selected runs with their seeds."""
        index = np.arange(self.runs)[which if isinstance(which, slice) else np.asarray(list(which), dtype=int)]
        values = {name: _taken(getattr(self, name), index, self.runs, name) for name in (*LEVELS, "seed")}
        return Draws(len(index), **values)

    def _checked(self, name: str) -> Array:
        array = floats(name, getattr(self, name), ParameterError)
        if np.any(np.isnan(array)) or (name != "effort_limit" and not np.all(np.isfinite(array))):
            raise ParameterError(f"{name} has entries that are not finite; expected finite numbers")
        fits = array.ndim == 0 or (name == "payload_position" and array.shape == (3,)) or len(array) == self.runs
        if not fits or array.ndim > (1 if name in PER_RUN else 2):
            raise ParameterError(
                f"{name} has shape {array.shape}; expected a scalar or one entry for each of {self.runs} runs"
            )
        if name in POSITIVE and not np.all(array > 0):
            raise ParameterError(f"the minimum of {name} is {array.min():g}; expected positive numbers")
        if name not in (*POSITIVE, *SIGNED) and not np.all(array >= 0):
            raise ParameterError(f"the minimum of {name} is {array.min():g}; expected 0 or more")
        return array

    def _seeds(self) -> NDArray[np.uint64]:
        seeds = np.arange(self.runs) if self.seed is None else np.asarray(self.seed)
        if seeds.shape not in ((), (self.runs,)) or seeds.dtype.kind not in "iu":
            raise ParameterError(
                f"seed is of {seeds.dtype} and shape {seeds.shape}; expected {self.runs} whole numbers"
            )
        return np.broadcast_to(seeds, self.runs).astype(np.uint64)


LEVELS = tuple(field.name for field in fields(Draws) if field.name not in ("runs", "seed"))


def width(name: str, n: int) -> int:
    """Return the length of a parameter that is not PER_RUN in a run of n joints."""
    return 3 if name == "payload_position" else n


def _taken(value: NDArray[np.generic], index: NDArray[np.int_], runs: int, name: str) -> NDArray[np.generic]:
    whole = value.ndim == 0 or (name == "payload_position" and value.ndim == 1)
    return value if whole else value[index]
