# SPDX-License-Identifier: Apache-2.0
"""What can go wrong, under one root: every message says what was seen and what was expected."""

LONGEST = 2000  # characters of a message: it may quote a value of any size


class FjrError(Exception):
    """Root of all errors that this project raises on purpose."""

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= LONGEST else f"{text[: LONGEST - 500]} ... {text[-450:]}"


class RobotError(FjrError):
    """A robot that cannot exist: wrong shape, not finite, not positive definite."""


class GainsError(FjrError):
    """Gains that void the proof: wrong shape, not positive definite, condition (32) or (41) broken."""


class TrajectoryError(FjrError):
    """A reference that is not C^4, not finite or of the wrong shape."""


class StateError(FjrError):
    """A state, input or simulation request of the wrong shape or not finite."""


class ParameterError(FjrError):
    """A named parameter of a scenario that is missing, unknown, of the wrong type or out of range."""


class CompareError(FjrError):
    """A comparison that cannot be made: an unknown law or imperfection, a suite that does not fit."""
