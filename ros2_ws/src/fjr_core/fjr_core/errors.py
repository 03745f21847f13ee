# SPDX-License-Identifier: Apache-2.0
"""What can go wrong, under one root: every message says what was seen and what was expected."""


class FjrError(Exception):
    """Root of all errors that this project raises on purpose."""


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
