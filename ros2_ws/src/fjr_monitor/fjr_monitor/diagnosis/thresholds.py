# SPDX-License-Identifier: Apache-2.0
"""Thresholds of the diagnosis, offline and online, and the joints that it names.

The thresholds were tuned on other seeds than the labelled set (docs/diagnosis.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.config.controller import CERTIFICATE_TOLERANCE
from fjr_core.config.parameter import Values, names, vector
from fjr_core.errors import StateError
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array

BLOCK = 20
"""Intervals per block: noise averages out within a block, a model mismatch does not."""
SHARE = 0.035
"""Smallest share of violated blocks of a violated run, if there are at least FEWEST."""
FEWEST = 3
"""Fewest blocks of a diagnosis, and fewest violated blocks for SHARE to apply."""
SHARE_OF_FEW = 0.1
"""Largest share of violated blocks, if they are fewer than FEWEST, of a run that still holds."""
HIGH_SHARE = 0.3
"""Smallest share of violated blocks of a violated run, whatever their number."""
EXCEEDED = 10.0
"""Largest growth of V over its lowest value plus its floor of a run that holds."""
DIVERGED = 100.0
"""Growth of V above which the run is violated, however small the errors are."""
TOLERANCE = float(CERTIFICATE_TOLERANCE.default)  # type: ignore[arg-type]
"""Largest tracking error [rad, m] due to the causes in a run that is degraded, not violated."""
RELATIVE = 0.1
"""Additional tracking error due to the causes, as a share of the loop's own error."""
FORESEEN = 2.0
"""Largest tracking error of a run that holds, as a multiple of that which hold and noise make in the model."""
UNSEEN = 0.01
"""Share of the tolerance up to which an error is not compared with that which the model foresees."""
OVERSHOOT = 10.0
"""Largest factor by which the decay of the initial error stays behind the guaranteed rate."""
CAUSE_SHARE = 0.2
"""A cause is reported if it is dominant in at least this share of the violating blocks."""
NOISE_DEVIATIONS = 2.0
"""Standard deviations of the contribution of the mean residual that count as noise."""
PREDICTED = 1.3
"""A block is violated if the causes contribute more than this multiple of hold and noise."""
SAME_EFFORT = 1e-6
"""Largest relative difference between the effort sent and that of the law if they are equal."""
AT_LIMIT = 0.999
"""An effort is at its limit from this share of the limit."""
CLIPPED_BY = 0.01
"""Smallest relative excess of the sent over the acting effort of a saturated motor."""
CLIPPED_LEVEL = 1e-3
"""Relative width of the torque level of a saturated motor."""
CLIPPED_FOR = 5
"""Consecutive intervals at that level of a saturated motor."""
WEAKEST, WEAK_LEAVES = 0.5, 0.1
"""Least factor of a weak motor, and the largest share of the missing torque that it leaves."""
DELAY_EXPLAINS = 0.5
"""Share of the motor residual that a delay must explain to be accepted."""
EXACT = 0.01
"""Accept the measured torque unconditionally if its residual is below this fraction of the motor residual."""
HALF_WAY = 0.3
"""Share of the residual that a change of the measured torque within the interval must explain to be accepted."""
NO_WORSE = 1.1
"""Accept the measured torque if its residual is at most this multiple of that of the best delay."""
OLDEST = 24
"""Largest delay searched, in samples."""
SAME_OLDER = 0.1
"""The acting torque is an older effort if its distance is at most this fraction of that from the newest."""
HELD = 0.75
"""Commands were lost, not late, if an older effort acts from begin to end in this share of its intervals."""
NEGLIGIBLE = 1e-8
"""Residual changes relative to those of the efforts that are due to rounding."""
LATE = 0.5
"""Median delay in samples from which deviations are a delay; below it, older efforts indicate losses."""
GAP = 1.85
"""Sample periods from which an interval is a gap."""
LONGEST_GAP = 20.0
"""Sample periods above which an interval is ignored."""
LONGEST_JUDGED = LONGEST_GAP * 1e-2
"""Time [s] above which the certificate does not compare two samples, at any rate."""
JUDGED = 0.2
"""Smallest share of blocks with the effort of the law for a diagnosis."""
FALLEN = 0.01
"""V has decayed if its maximum in the last third of a run is below this fraction of that in the first third."""
REGULAR = 0.1
"""Largest relative difference from the usual length of an interval used for the delay in real time."""
UNSURE = 0.35
"""Uncertainty, as a fraction of the sample period, of the instant at which a new effort takes effect."""


LARGE = 0.0995  # rad, m; errors that are below 100 thousandths once rounded are written in these


@dataclass(frozen=True)
class JointTolerances:
    """Names, units and tolerances of the joints in a diagnosis.

    names, units: of n joints; a unit is "rad" or "m". tolerance (n,) [rad, m]: tracking error up to which a violation
    of the decay of V is a degradation. Raises StateError for numbers that do not fit.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    tolerance: Array

    def __post_init__(self) -> None:
        tolerance = checks.positive_vector("tolerance", self.tolerance, len(self.names), StateError)
        if len(self.units) != len(self.names):
            raise StateError(f"units are {self.units}; expected one for each of {len(self.names)} joints")
        object.__setattr__(self, "tolerance", tolerance)

    @classmethod
    def of(cls, values: Values, robot: Robot) -> JointTolerances:
        """Return the joints of a controller's parameters; raise ParameterError."""
        units = tuple(each.position for each in robot.units)
        return cls(names(values, "joints"), units, vector(values, CERTIFICATE_TOLERANCE.name, robot.n))

    @classmethod
    def plain(cls, n: int) -> JointTolerances:
        """Return n revolute joints called joint1 .. jointn with the default tolerance."""
        return cls(tuple(f"joint{j + 1}" for j in range(n)), ("rad",) * n, np.full(n, TOLERANCE))

    def storage(self, law: TrackingLaw) -> float:
        """Return V = e' Pi_l e / 2 [J] of links at rest whose error e is the tolerance, at least TOLERANCE."""
        e = np.maximum(self.tolerance, TOLERANCE)
        return float(e @ law.gains.Pi_l @ e) / 2

    def largest(self, errors: Array) -> str:
        """Format the largest of errors (n,) relative to its tolerance: "0.14 mrad at joint2"."""
        j = int(np.argmax(errors / self.tolerance))
        size = f"{errors[j]:.2g} " if errors[j] >= LARGE else f"{1e3 * errors[j]:.2g} m"
        return f"{size}{self.units[j]} at {self.names[j]}"
