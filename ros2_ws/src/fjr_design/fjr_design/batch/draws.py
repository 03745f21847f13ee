# SPDX-License-Identifier: Apache-2.0
"""Drawn deviations of robot, sensors and loop in k runs, by their names in the glossary: values and distributions.

Random numbers are counter-based, so that any run of a study can be drawn on its own: NumPy's Philox4x64-10 (J. Salmon,
M. Moraes, R. Dror, D. Shaw, SC 2011); noise.c implements the same generator.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import ParameterError
from fjr_core.numerics.checks import Array, floats
from fjr_core.simulation.deviations import DEVIATIONS, NONNEGATIVE, POINT, POSITIVE, Deviation
from fjr_msgs_py.console.output import tell

WORDS = 4  # random words per counter
UNIFORM, NORMAL, LOG_UNIFORM, FIXED = "uniform", "normal", "log_uniform", "fixed"
LOG_NORMAL = "log_normal"
WIDEST = 4.0  # standard deviations at which a normal distribution is truncated
EACH_JOINT = "each_joint"
COUNTED_AS = {"link_torque": "external"}
"""Names that determine the random numbers of a deviation, where they differ from its own: its former ones."""
FORM = (
    "{uniform: [low, high]}, {log_uniform: [low, high]}, {normal: [mean, deviation]}, "
    "{log_normal: [median, deviation of the logarithm]}, or a number"
)


NOT_DRAWN = ("payload", "link_central_inertia", "gravity_direction", "motor_torque")
PARAMETERS = {name: one for name, one in DEVIATIONS.items() if name not in NOT_DRAWN}  # by name


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

    def __init__(self, runs: int, seed: ArrayLike | None = None, **values: ArrayLike) -> None:
        if isinstance(runs, bool) or not isinstance(runs, (int, np.integer)) or runs < 0:
            raise ParameterError(f"runs is {runs!r}; expected a whole number, 0 or more")
        if unknown := values.keys() - PARAMETERS.keys():
            raise ParameterError(f"{', '.join(unknown)} is not drawn; expected some of {', '.join(PARAMETERS)}")
        seeds = np.arange(runs) if seed is None else np.asarray(seed)
        if seeds.shape not in ((), (runs,)) or seeds.dtype.kind not in "iu":
            raise ParameterError(f"seed is of {seeds.dtype} and shape {seeds.shape}; expected {runs} whole numbers")
        self.runs, self.seed = runs, np.broadcast_to(seeds, runs).astype(np.uint64)
        self.values = {name: self._checked(one, values.get(name, one.nominal)) for name, one in PARAMETERS.items()}

    def columns(self, name: str, n: int) -> Array:
        """Return one field as (k, n), as (k, 1) if it is per run, or as (k, 3) for payload_position."""
        value, most = self.values[name], PARAMETERS[name].width(n)
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
        values = {
            name: value if value.ndim == 0 or (name == "payload_position" and value.ndim == 1) else value[index]
            for name, value in self.values.items()
        }
        return Draws(len(index), self.seed[index], **values)

    def _checked(self, one: Deviation, value: ArrayLike) -> Array:
        name, array = one.name, floats(one.name, value, ParameterError)
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


def stream(name: str) -> int:
    """Return the second word of the random key of a parameter name; it is never 0, which the noise uses."""
    return zlib.crc32(COUNTED_AS.get(name, name).encode()) | 1 << 32


def uniform(name: str, seed: int, first: int, count: int, width: int) -> Array:
    """Return uniform numbers (count, width) of a name in the runs from `first` on."""
    return unit(rows((seed, stream(name)), first, count, width))


@dataclass(frozen=True)
class Distribution:
    """Distribution of a kind with its numbers: low and high, mean and standard deviation, or fixed values.

    Those of a log-normal distribution are the median and the standard deviation of the natural logarithm. each_joint:
    drawn separately for every joint, else once for all. Normal distributions are truncated at WIDEST standard
    deviations.
    """

    kind: str
    numbers: tuple[float, ...]
    each_joint: bool = False

    @property
    def range(self) -> tuple[float, float]:
        """Return the smallest and the largest value that can be drawn."""
        if self.kind == NORMAL:
            mean, deviation = self.numbers
            return mean - WIDEST * deviation, mean + WIDEST * deviation
        if self.kind == LOG_NORMAL:
            median, deviation = self.numbers
            return median * float(np.exp(-WIDEST * deviation)), median * float(np.exp(WIDEST * deviation))
        return min(self.numbers), max(self.numbers)

    def at(self, share: Array) -> Array:
        """Return the quantile of a share in [0, 1), elementwise."""
        low, high = self.numbers[0], self.numbers[-1]
        if self.kind == UNIFORM:
            return np.asarray(low + (high - low) * share)
        if self.kind == LOG_UNIFORM:
            return np.asarray(low * (high / low) ** share)
        normal = standard_normal(share)
        return np.asarray(low * np.exp(high * normal) if self.kind == LOG_NORMAL else low + high * normal)

    def share(self, value: Array) -> Array:
        """Return the cumulative probability of a value, the inverse of `at`."""
        low, high = self.numbers[0], self.numbers[-1]
        if self.kind == UNIFORM:
            return np.asarray((value - low) / (high - low))
        if self.kind == LOG_UNIFORM:
            return np.asarray(np.log(value / low) / np.log(high / low))
        from scipy.special import ndtr  # loaded on use: see law/gains.py

        outside = ndtr(-WIDEST)
        normal = np.log(value / low) / high if self.kind == LOG_NORMAL else (value - low) / high
        return np.asarray((ndtr(normal) - outside) / (1 - 2 * outside))

    def drawn(self, name: str, seed: int, first: int, count: int, n: int) -> Array:
        """Return the values of the runs from `first` on: (count, n) with each_joint, else (count, 1); or fixed ones."""
        if self.kind == FIXED:
            return np.tile(self.numbers, (count, 1))
        return self.at(uniform(name, seed, first, count, n if self.each_joint else 1))

    @property
    def as_yaml(self) -> Any:
        """Return the plain value from which `read` makes this distribution."""
        if self.kind == FIXED:
            return list(self.numbers) if len(self.numbers) > 1 else self.numbers[0]
        return {self.kind: list(self.numbers)} | ({EACH_JOINT: True} if self.each_joint else {})


class DrawnColumn(NamedTuple):
    """A drawn number of each run: its column in the table, the field of Draws and entry in it, its distribution."""

    column: str
    name: str
    entry: int
    distribution: Distribution


def standard_normal(share: Array, widest: float = WIDEST) -> Array:
    """Return standard normal numbers at a share in [0, 1), truncated at +-widest."""
    from scipy.special import ndtr, ndtri  # loaded on use: see law/gains.py

    outside = ndtr(-widest)
    return np.asarray(ndtri(outside + (1 - 2 * outside) * share))


def varied(given: Mapping[str, object]) -> dict[str, Distribution]:
    """Return the distributions under `vary` by deviation; raises ParameterError. A former name is reported."""
    former = {old: name for name, old in COUNTED_AS.items()}
    for old in given.keys() & former:
        if former[old] in given:
            raise ParameterError(f"'vary' has '{old}' beside its new name '{former[old]}'; expected the latter alone")
        tell(f"'{old}' under 'vary' is deprecated; use '{former[old]}'")
    return {former.get(str(name), str(name)): read(str(name), one) for name, one in given.items()}


def read(name: str, given: object) -> Distribution:
    """Return the distribution given in a sweep file; raises ParameterError."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return Distribution(FIXED, _numbers(name, [given]))
    if isinstance(given, Sequence) and not isinstance(given, str):
        return Distribution(FIXED, _numbers(name, given))
    if not isinstance(given, Mapping):
        raise ParameterError(f"'{name}' is {given!r}; expected {FORM}")
    kinds = [key for key in given if key in (UNIFORM, NORMAL, LOG_UNIFORM, LOG_NORMAL)]
    unknown = [key for key in given if key not in (*kinds, EACH_JOINT)]
    if len(kinds) != 1 or unknown or not isinstance(given.get(EACH_JOINT, False), bool):
        raise ParameterError(f"'{name}' is {dict(given)}; expected {FORM}, optionally with each_joint: true")
    return _checked(name, Distribution(kinds[0], _numbers(name, given[kinds[0]]), given.get(EACH_JOINT, False)))


def _checked(name: str, one: Distribution) -> Distribution:
    """Return a distribution of two numbers; raises ParameterError unless they fit its kind."""
    if len(one.numbers) != 2:
        raise ParameterError(f"'{name}' has {len(one.numbers)} numbers; expected two for {one.kind}")
    low, high = one.numbers
    if one.kind in (NORMAL, LOG_NORMAL) and not high > 0:
        raise ParameterError(f"'{name}' has the standard deviation {high:g}; expected more than 0")
    if one.kind in (UNIFORM, LOG_UNIFORM) and not low < high:
        raise ParameterError(f"'{name}' goes from {low:g} to {high:g}; expected the smaller number first")
    if one.kind in (LOG_UNIFORM, LOG_NORMAL) and not low > 0:
        raise ParameterError(f"'{name}' starts at {low:g}; expected more than 0 for {one.kind}")
    return one


def _numbers(name: str, given: object) -> tuple[float, ...]:
    try:
        numbers = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if numbers.ndim != 1 or not len(numbers) or not np.all(np.isfinite(numbers)):
        raise ParameterError(f"'{name}' has {given!r}; expected a list of finite numbers")
    return tuple(numbers.tolist())
