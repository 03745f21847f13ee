# SPDX-License-Identifier: Apache-2.0
"""Draw a closed-loop run with Matplotlib, which is imported on use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import FjrError
from ..model.robot import joined
from ..numerics.checks import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .closed_loop import Trajectory


class PlotError(FjrError):
    """Matplotlib is not installed."""


def draw(run: Trajectory) -> Figure:
    """Return a figure of positions, tracking errors q_l - q_ld, efforts and V over time, a colour for each joint.

    Raises PlotError if Matplotlib cannot be imported.
    """
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise PlotError(f"Matplotlib cannot be imported ({error}); expected it from: pip install matplotlib") from None
    figure, ((position, effort), (deviation, storage)) = pyplot.subplots(
        2, 2, sharex=True, figsize=(9, 5), layout="constrained"
    )
    n = run.u.shape[1]
    q_l, q_ld = run.x[:, :n], run.jets[:, 0]
    length, force = (joined(getattr(each, name) for each in run.units) for name in ("position", "effort"))
    _lines(position, f"q_l [{length}]", run.t, q_l)
    for joint, line in enumerate(position.lines[:]):
        position.plot(run.t, q_ld[:, joint], "--", color=line.get_color(), alpha=0.6)
    _lines(deviation, f"q_l - q_ld [{length}]", run.t, q_l - q_ld)
    _lines(effort, f"u [{force}]", run.t, run.u)
    _lines(storage, "V [J]", run.t, run.V[:, None])
    if np.any(run.V > 0):
        storage.set_yscale("log")
    for axes in (deviation, storage):
        axes.set_xlabel("t [s]")
    position.set_title("links (dashed: reference)", fontsize="medium")
    if n > 1:
        figure.legend(effort.lines, [f"joint {i + 1}" for i in range(n)], loc="outside right upper", fontsize="small")
    return figure


def _lines(axes: Axes, label: str, t: Array, values: Array) -> None:
    """Plot the columns of values (k, n)."""
    axes.plot(t, values)
    axes.set_ylabel(label)
    axes.grid(alpha=0.3)
