# SPDX-License-Identifier: Apache-2.0
"""Guessed values of a robot file: robot.guesses.* repeat them, so that each is reported until it is replaced."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..numerics.checks import Array
from .parameter import VECTOR, Parameter, Values, names

GUESSED = ("joint_stiffness", "motor_inertia")
GUESSES = {
    name: Parameter(
        f"robot.guesses.{name}",
        0.0,
        f"Guess of robot.{name}; a value that still equals its guess is reported; 0: none",
        minimum=0.0,
        shape=VECTOR,
    )
    for name in GUESSED
}


def guess_parameters(n: int) -> list[Parameter]:
    """Return the parameters robot.guesses.* for n joints."""
    return [parameter.for_joints(n) for parameter in GUESSES.values()]


def guessed_joints(values: Values) -> dict[str, tuple[str, ...]]:
    """Return the joints whose value still equals its guess, by the name of the value, where there are any."""
    joints = np.array(names(values, "joints"))
    found = {name: joints[_guessed(values, name, len(joints))] for name in GUESSED}
    return {name: tuple(map(str, each)) for name, each in found.items() if len(each)}


def guess_sentences(values: Values) -> tuple[str, ...]:
    """Return a sentence for each kind of value that is a guess."""
    return tuple(
        f"{name.replace('_', ' ')} of {_joints(joints)} is a guess; replace it by a measured or data-sheet value "
        f"in robot.{name}"
        for name, joints in guessed_joints(values).items()
    )


def _joints(joints: tuple[str, ...]) -> str:
    return f"joint {joints[0]}" if len(joints) == 1 else f"{len(joints)} joints"


def _guessed(values: Mapping[str, Any], name: str, n: int) -> Array:
    """Return which joints have the guess as their value (n,); of a matrix the diagonal counts."""
    guess = np.asarray(values.get(GUESSES[name].name, np.zeros(n)), dtype=float)
    value = np.asarray(values.get(f"robot.{name}", np.zeros(n)), dtype=float)
    if value.size == n * n and n > 1:
        value = np.diag(value.reshape(n, n))
    if guess.shape != (n,) or value.shape != (n,):
        return np.zeros(n, dtype=bool)
    return np.asarray((guess > 0) & (value == guess))
