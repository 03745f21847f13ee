# SPDX-License-Identifier: Apache-2.0
"""Exceptions of the project; every message states what is wrong and what was expected."""

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager

LONGEST = 2000  # characters; messages may quote values of any size
PIP = f"{shlex.quote(sys.executable)} -m pip install"  # into the Python that runs: `pip` alone may be of another one


class FjrError(Exception):
    """Base class of all errors that this project raises on purpose."""

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= LONGEST else f"{text[: LONGEST - 500]} ... {text[-450:]}"


class RobotError(FjrError):
    """Invalid robot parameters: wrong shape, not finite, not positive definite."""


class GainsError(FjrError):
    """Gains outside the stability proof: wrong shape, not positive definite, or condition (32) or (41) violated."""


class TrajectoryError(FjrError):
    """Invalid reference: not of class C^4, not finite or of the wrong shape."""


class StateError(FjrError):
    """Invalid state, input or simulation request: wrong shape or not finite."""


class ParameterError(FjrError):
    """Invalid parameter of a scenario, or key of a study: missing, unknown, of the wrong type or out of range."""


@contextmanager
def prefixed(start: str, kind: type[FjrError] = ParameterError, new: type[FjrError] = ParameterError) -> Iterator[None]:
    """Turn an error of this kind in the block into a `new` one, whose sentence begins with `start`."""
    try:
        yield
    except kind as error:
        raise new(f"{start}{error}") from None


class RecordError(FjrError):
    """Record of motion that cannot be read, or that contradicts itself or the robot."""


class UserCodeError(FjrError):
    """Failure of code of the user, a law or a plant: an exception, or a result of the wrong shape."""


class MissingPackageError(FjrError):
    """A package is not installed."""


class CompilerError(FjrError):
    """No C compiler, or one that fails, where compiled code is needed."""
