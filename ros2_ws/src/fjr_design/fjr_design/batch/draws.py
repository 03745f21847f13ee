# SPDX-License-Identifier: Apache-2.0
"""Drawn deviations of robot, sensors and loop in k runs, by their names in the glossary.

Random numbers are counter-based, so that any run of a study can be drawn on its own: NumPy's Philox4x64-10 (J. Salmon,
M. Moraes, R. Dror, D. Shaw, SC 2011); noise.c implements the same generator.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import ParameterError
from fjr_core.numerics.checks import Array, floats, freeze
from fjr_core.simulation.deviations import DEVIATIONS, NONNEGATIVE, POINT, POSITIVE, Deviation

WORDS = 4
"""Random words per counter."""


@dataclass(frozen=True, eq=False)
class Draws:
    """Values of all PARAMETERS in k runs: each a scalar for all runs, (k,), or (k, n) per joint; nominal by default.

    Factors on plant parameters: link_mass (mass and inertia of each link), stiffness, link_inertia, gravity,
    motor_inertia, link_damping, motor_damping (see parametric_robot for matrices; damping may be 0, gravity of either
    sign). Levels: coulomb_l, coulomb_m [N m]: Coulomb friction of links and motors, times tanh(v / smoothing);
    smoothing [rad/s] (k,); link_torque [N m]: constant; cubic [N m/rad^3]: stiffness beside the curve of the springs,
    also negative; hysteresis [N m] and slip [rad]: of a Maxwell element beside each spring (nonideal_plant);
    payload_mass [kg] (k,) at payload_position (3,) or (k, 3) [m] in the frame of the last link;
    delay [s] (k,) from a sample to its effort, any fraction of the sample period; position_noise [rad] and
    velocity_noise [rad/s] (k,): standard deviations of white noise; resolution [rad] (k,) of the encoders, 0: exact;
    effort_limit [N m]: saturation of the command, known to the law. seed (k,) uint64: of the noise; default: number of
    the run. Raises ParameterError.
    """

    runs: int
    stiffness: ArrayLike = 1.0
    link_mass: ArrayLike = 1.0
    link_inertia: ArrayLike = 1.0
    gravity: ArrayLike = 1.0
    motor_inertia: ArrayLike = 1.0
    link_damping: ArrayLike = 1.0
    motor_damping: ArrayLike = 1.0
    coulomb_l: ArrayLike = 0.0
    coulomb_m: ArrayLike = 0.0
    smoothing: ArrayLike = DEVIATIONS["smoothing"].nominal
    link_torque: ArrayLike = 0.0
    cubic: ArrayLike = 0.0
    hysteresis: ArrayLike = 0.0
    slip: ArrayLike = DEVIATIONS["slip"].nominal
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
        for each in PARAMETERS.values():
            freeze(self, each.name, self._checked(each))
        seeds = np.arange(self.runs) if self.seed is None else np.asarray(self.seed)
        if seeds.shape not in ((), (self.runs,)) or seeds.dtype.kind not in "iu":
            raise ParameterError(
                f"seed is of {seeds.dtype} and shape {seeds.shape}; expected {self.runs} whole numbers"
            )
        freeze(self, "seed", np.broadcast_to(seeds, self.runs).astype(np.uint64))

    def columns(self, name: str, n: int) -> Array:
        """Return one field as (k, n), as (k, 1) if it is per run, or as (k, 3) for payload_position."""
        value, most = np.asarray(getattr(self, name)), PARAMETERS[name].width(n)
        each = value.shape == (self.runs,) and PARAMETERS[name].per != POINT  # a list of it is always x, y, z
        column = value[:, None] if each else value
        if column.ndim and column.shape[-1] not in (1, most):
            raise ParameterError(
                f"{name} has shape {value.shape}; expected a scalar, ({self.runs},) or {(self.runs, most)}"
            )
        return np.ascontiguousarray(np.broadcast_to(column, (self.runs, most)))

    def taken(self, which: slice | Iterable[int]) -> Draws:
        """Return the selected runs with their seeds."""
        index = np.arange(self.runs)[which if isinstance(which, slice) else np.asarray(list(which), dtype=int)]
        values = {}
        for name in (*PARAMETERS, "seed"):
            value = np.asarray(getattr(self, name))
            for_all = value.ndim == 0 or (name == "payload_position" and value.ndim == 1)
            values[name] = value if for_all else value[index]
        return Draws(len(index), **values)

    def _checked(self, one: Deviation) -> Array:
        name, array = one.name, floats(one.name, getattr(self, one.name), ParameterError)
        if np.any(np.isnan(array)) or (name != "effort_limit" and not np.all(np.isfinite(array))):
            raise ParameterError(f"{name} has entries that are not finite; expected finite numbers")
        fits = array.ndim == 0 or (one.per == POINT and array.shape == (3,)) or len(array) == self.runs
        if not fits or array.ndim > (1 if one.per_run else 2):
            raise ParameterError(
                f"{name} has shape {array.shape}; expected a scalar or one entry for each of {self.runs} runs"
            )
        if one.sign == POSITIVE and not np.all(array > 0):
            raise ParameterError(f"the minimum of {name} is {array.min():g}; expected positive numbers")
        if one.sign == NONNEGATIVE and not np.all(array >= 0):
            raise ParameterError(f"the minimum of {name} is {array.min():g}; expected 0 or more")
        return array


PARAMETERS = {each.name: DEVIATIONS[each.name] for each in fields(Draws) if each.name in DEVIATIONS}
"""The deviations that a study draws, by name."""


def unit_of(column: str) -> str:
    """Return the unit of a drawn number, NAME or NAME.JOINT; "" for factors."""
    name = column.partition(".")[0]
    return PARAMETERS[name].unit if name in PARAMETERS else ""


def words(key: tuple[int, int], first: int, count: int) -> NDArray[np.uint64]:
    """Return the random words (count, 4) at the counters first, first + 1, ...; key: two words; first < 2^256."""
    before = (first - 1) % 2**256  # NumPy increments the counter before the first block
    counter = np.array([before >> (64 * i) & (2**64 - 1) for i in range(4)], dtype=np.uint64)
    generator = np.random.Philox(key=np.array(key, dtype=np.uint64), counter=counter)
    return generator.random_raw(WORDS * count).reshape(count, WORDS)


def rows(key: tuple[int, int], first: int, count: int, width: int) -> NDArray[np.uint64]:
    """Return words (count, width) of the rows first .. first + count - 1; a row depends only on its number."""
    blocks = -(-width // WORDS)
    return words(key, first * blocks, count * blocks).reshape(count, blocks * WORDS)[:, :width]


def unit(drawn: NDArray[np.uint64]) -> Array:
    """Convert words to uniform numbers in [0, 1) with 53 bits, as NumPy does."""
    return np.asarray((drawn >> np.uint64(11)) * 2.0**-53)
