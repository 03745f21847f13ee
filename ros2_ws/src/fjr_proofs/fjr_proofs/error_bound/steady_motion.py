# SPDX-License-Identifier: Apache-2.0
"""Find the centre motion along which the sampled loop is steady: Newton's method with one linear model.

The steady response of the linear model to the defect of the law and the age of the effort is added to the motion of
the links until both balance on average over a sample. With cells of several samples the result is the same, as only
the defect in their middle counts.
"""

from __future__ import annotations

import numpy as np

from fjr_core.numerics.checks import Array

from .centre_motion import CentreMotion
from .deviation_model import DeviationModel
from .ranges import Ranges
from .reference_cells import Cells
from .sampled_deviation import LinearCells, linear_cells
from .steady_response import steady_response

STEPS = 5


def steady_motion(
    model: DeviationModel, cells: Cells, factors: Array, delay: float, start: CentreMotion | None = None
) -> CentreMotion:
    """Return the centre motion of a robot with the factors (7,); delay [s].

    The links stay on the reference if it has no period or the loop is unstable. start: motion from which it is found.
    """
    centre = CentreMotion.ideal(cells, factors) if start is None else start.about(cells, factors)
    if not cells.periodic:
        return centre
    linear = linear_cells(model, centre, delay)
    if spectral_radius(linear) >= 1:
        return centre
    for _ in range(STEPS):
        drive = Ranges(model, centre, factors, factors, 1, delay).drive()
        y = steady_response(linear, cells, drive).Z[:, : 4 * model.n, 0]
        centre = centre.moved(y @ linear.coordinates.S_inverse[: model.n].T)
    return centre


def spectral_radius(linear: LinearCells) -> float:
    """Return the largest spectral radius of the sampled loops of the cells."""
    return float(np.abs(np.linalg.eigvals(linear.models.loop)).max())
