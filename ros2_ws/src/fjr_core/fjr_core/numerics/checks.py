# SPDX-License-Identifier: Apache-2.0
"""Validate input: return finite arrays of the expected shape, or raise the given error."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import FjrError, TrajectoryError

Array = NDArray[np.float64]
MOTOR = "_motor"
"""Ending of the name of a joint's motor side."""


def floats(name: str, value: Any, error: type[FjrError], shape: str = "") -> Array:
    """Return `value` as a new float array; raise `error` unless all entries are real. shape: for the message."""
    try:
        if np.iscomplexobj(value):  # NumPy would drop the imaginary part
            raise error(f"{name} is complex; expected real numbers{shape}")
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise error(f"{name} is {value!r}; expected numbers{shape}") from None


def finite(name: str, value: ArrayLike, error: type[FjrError]) -> Array:
    """Return `value` as a float array; raise `error` unless all entries are finite numbers."""
    array = floats(name, value, error)
    if not np.all(np.isfinite(array)):
        raise error(f"{name} is {array.tolist()}; expected finite numbers")
    return array


def vector(name: str, value: ArrayLike, n: int, error: type[FjrError]) -> Array:
    """Return `value` as (n,); a scalar stands for n equal entries. Raises `error`."""
    return filled(name, finite(name, value, error), (n,), error)


def positive_vector(name: str, value: ArrayLike, n: int, error: type[FjrError]) -> Array:
    """Return `value` as (n,), as `vector` does; raise `error` unless all entries are positive."""
    array = vector(name, value, n, error)
    if not np.all(array > 0):
        raise error(f"{name} is {array.tolist()}; expected positive numbers")
    return array


def filled(name: str, array: Array, shape: tuple[int, ...], error: type[FjrError]) -> Array:
    """Return an array of this shape; a scalar stands for equal entries. Raises `error`."""
    if array.shape not in ((), shape):
        raise error(f"{name} has shape {array.shape}; expected a scalar or {shape}")
    return np.array(np.broadcast_to(array, shape))


def matrix(name: str, value: ArrayLike, n: int, error: type[FjrError]) -> Array:
    """Return `value` as (n, n); a scalar or a vector stands for a diagonal matrix. Raises `error`."""
    array = finite(name, value, error)
    if array.shape in ((), (n,)):
        return np.diag(vector(name, array, n, error))
    if array.shape != (n, n):
        raise error(f"{name} has shape {array.shape}; expected a scalar, ({n},) or ({n}, {n})")
    return array


def is_diagonal(array: Array) -> bool:
    """Return whether a square matrix is 0 off its diagonal."""
    return np.array_equal(array, np.diag(np.diag(array)))


def limits(name: str, value: ArrayLike, n: int, error: type[FjrError]) -> Array:
    """Return limits (n,), infinite for none; a scalar stands for n equal ones. Raises `error`, also for nan."""
    array = floats(name, value, error)
    if array.shape not in ((), (n,)) or np.any(np.isnan(array)):
        expected = f"a number or {n}, one per joint, infinite for none"
        raise error(f"{name} is {array.tolist()}; expected {expected}")
    return np.array(np.broadcast_to(array, n))


def joint_names(where: str, value: object, error: type[FjrError]) -> tuple[str, ...]:
    """Return names of joints as a tuple. where: they stand, for the message.

    Raises `error` unless they are different words of printable characters, none of which names another's motor side.
    """
    if isinstance(value, str) or not isinstance(value, Sequence) or not value:
        raise error(f"{where} is {value!r}; expected a list of joint names")
    for name in value:
        if not isinstance(name, str) or not name or not name.isprintable() or name != name.strip():
            raise error(f"{where} holds {name!r}; expected names of printable characters without spaces at their ends")
        if value.count(name) > 1:
            raise error(f"{where} holds {name!r} twice; expected every joint once")
        if f"{name}{MOTOR}" in value:
            raise error(f"{where} holds {name!r} and '{name}{MOTOR}', the name of its motor side; expected others")
    return tuple(value)


def symmetric(name: str, array: Array, error: type[FjrError]) -> Array:
    """Return the symmetric part of `array`; raise `error` unless it is symmetric to rounding."""
    asymmetry = float(np.max(np.abs(array - array.T)))
    if asymmetry > 1e-12 * float(np.max(np.abs(array))):
        raise error(f"{name} is not symmetric (largest difference {asymmetry:.3g}); expected a symmetric matrix")
    return (array + array.T) / 2


def positive_definite(name: str, array: Array, error: type[FjrError]) -> Array:
    """Return the symmetric part of `array`; raise `error` unless it is symmetric positive definite."""
    array = symmetric(name, array, error)
    smallest, largest = np.linalg.eigvalsh(array)[[0, -1]]
    if not smallest > 1e-14 * largest:
        raise error(f"{name} has smallest eigenvalue {smallest:.3g}; expected a positive definite matrix")
    return array


def positive_semidefinite(name: str, array: Array, error: type[FjrError]) -> Array:
    """Return the symmetric part of `array`; raise `error` unless it is symmetric positive semidefinite."""
    array = symmetric(name, array, error)
    smallest = float(np.linalg.eigvalsh(array)[0])
    if smallest < -1e-14 * float(np.max(np.abs(array))):
        raise error(f"{name} has smallest eigenvalue {smallest:.3g}; expected a positive semidefinite matrix")
    return array


def joint_vector(name: str, value: ArrayLike) -> Array:
    """Return `value` as (n,), n at least 1; raise TrajectoryError."""
    array = finite(name, value, TrajectoryError)
    if array.ndim != 1 or not array.size:
        raise TrajectoryError(f"{name} has shape {array.shape}; expected (n,), one number per joint")
    return array


def number(name: str, value: ArrayLike) -> float:
    """Return `value` as one finite number; raise TrajectoryError."""
    return float(vector(name, value, 1, TrajectoryError)[0])


def positive(
    name: str, value: Any, error: type[FjrError] = TrajectoryError, unit: str = "s", zero: bool = False
) -> float:
    """Return `value` as one number; raise `error` unless it is finite and positive. zero: permit 0."""
    array = floats(name, value, error)
    if array.size != 1 or not np.isfinite(array).all() or array.min() < 0 or not (zero or array.all()):
        raise error(f"{name} is {value} {unit}; expected {'0 or more' if zero else 'a positive finite number'}")
    return array.item()


def instance(name: str, value: object, kind: type, error: type[FjrError], expected: str) -> None:
    """Raise `error` unless `value` is an object of `kind`; expected: for the message."""
    if not isinstance(value, kind):
        raise error(f"{name} is {kind_of(value)}; expected {expected}")


def kind_of(value: object) -> str:
    """Return what `value` is, for the message of an error: a function, a class, or an object of a type."""
    if inspect.isclass(value):
        return f"the class {value.__name__}"
    return "a function" if inspect.isroutine(value) else f"a {type(value).__name__}"


def freeze(owner: object, name: str, array: NDArray[Any]) -> None:
    """Set a field of the frozen dataclass `owner` to `array` and make the array read-only."""
    array.setflags(write=False)
    object.__setattr__(owner, name, array)
