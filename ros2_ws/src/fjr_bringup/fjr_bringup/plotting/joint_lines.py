# SPDX-License-Identifier: Apache-2.0
"""Colours and end labels of joints in Matplotlib figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from fjr_bringup.analysis.run_data import RunData
from fjr_bringup.recording.reader import Array

# Okabe and Ito's palette, distinguishable by colour-blind readers
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DRAWABLE = 1e12
LABEL_GAP = 0.062  # of the height of the axes, between names
LONGEST = 16  # characters of a name


def colour(joint: int) -> str:
    """Return the colour of a joint."""
    return COLOURS[joint % len(COLOURS)]


def drawable(values: Array) -> Array:
    """Replace values of a diverged loop (above DRAWABLE) by NaN."""
    return np.where(np.abs(values) < DRAWABLE, values, np.nan)


def labels(joints: Sequence[str]) -> list[str]:
    """Return names of at most LONGEST characters, the last ones, without the ending _joint if all have it."""
    end = "_joint" if all(name.endswith("_joint") for name in joints) else ""
    names = [name.removesuffix(end) for name in joints]
    return [name if len(name) <= LONGEST else f"…{name[1 - LONGEST :]}" for name in names]


def name_joints(ax: Axes, data: RunData, lines: Array) -> None:
    """Label the ends of the lines (k, n) with the joint names, without overlap; a single joint gets no label."""
    if len(data.joints) == 1:
        return
    ax.get_ylim()  # updates transData
    ends, names = {}, labels(data.joints)
    for j in range(len(data.joints)):
        drawn = lines[np.isfinite(drawable(lines[:, j])), j]
        if drawn.size:
            point = ax.transData.transform((data.t[-1], drawn[-1]))
            ends[j] = float(ax.transAxes.inverted().transform(point)[1])
    for j, height in zip(ends, apart(np.array(list(ends.values()))), strict=True):
        ax.annotate(
            names[j],
            (data.t[-1], height),
            (4, 0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            color=colour(j),
            va="center",
        )


def apart(heights: Array) -> list[float]:
    """Move heights at least LABEL_GAP apart with the least displacement; all within 0 and 1.

    Close neighbours are centred on their mean.
    """
    order = np.argsort(heights)
    groups: list[list[float]] = []
    for place, height in enumerate(heights[order]):
        groups.append([height - LABEL_GAP * place])
        while len(groups) > 1 and np.mean(groups[-2]) > np.mean(groups[-1]):
            groups[-2:] = [groups[-2] + groups[-1]]
    highest = 1.0 - LABEL_GAP * (len(heights) - 1)
    placed = [min(max(float(np.mean(group)), 0.0), highest) for group in groups for _ in group]
    return [placed[rank] + LABEL_GAP * float(rank) for rank in np.argsort(order)]
