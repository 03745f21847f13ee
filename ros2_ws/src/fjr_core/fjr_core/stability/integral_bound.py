# SPDX-License-Identifier: Apache-2.0
"""Refuse integral action that destabilises the sampled loop, and compute the largest stable gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import GainsError
from ..law.interfaces import StaticLaw
from ..model.configuration_sampling import sample_configurations
from ..numerics.checks import Array
from ..robust.law import Robust, sampled_law
from .sampled_loop import spectral_radius

NAMES = ("integral_gain", "motor_integral_gain")
CONFIGURATIONS = 3  # sampled configurations at which the loop is evaluated
BISECTIONS = 7  # of the logarithm of the factor on the gains, between LEAST and 1
LEAST = 1e-4
DIGITS = 2


def refuse_fast_integral(law: StaticLaw, robust: Robust) -> None:
    """Raise GainsError if integral action makes an otherwise stable loop unstable at sample period robust.hold [s].

    The loop consists of the law and its own robot, linearised at a few equilibria, with the delay robust.delay [s].
    """
    if not robust.integrates or _stable(law, robust, 1.0) or not _stable(law, robust, 0.0):
        return
    low, high = LEAST, 1.0
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if _stable(law, robust, middle) else (low, middle)
    gains = {name: np.asarray(getattr(robust, name)) for name in NAMES if np.any(getattr(robust, name))}
    given = ", ".join(f"{name} is {_rates(gain)}" for name, gain in gains.items())
    most = " and ".join(_rates(low * gain) for gain in gains.values())
    raise GainsError(
        f"{given} 1/s, which makes the loop unstable at a hold of {robust.hold:g} s; expected at most {most} 1/s"
    )


def _stable(law: StaticLaw, robust: Robust, factor: float) -> bool:
    rates = {name: factor * np.asarray(getattr(robust, name)) for name in NAMES}
    where = sample_configurations(law.robot, CONFIGURATIONS)
    sampled = sampled_law(law, replace(robust, **rates))  # type: ignore[arg-type]
    return bool(spectral_radius(sampled, robust.hold, robust.delay, where).max() < 1)


def _rates(values: Array) -> str:
    return "[" + ", ".join(f"{value:.{DIGITS}g}" for value in np.atleast_1d(values)) + "]"
