# SPDX-License-Identifier: Apache-2.0
"""Format the headline metrics of a run with unit and, for several joints, the joint concerned."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fjr_core.model.robot import joined
from fjr_monitor.analysis.metrics import Report
from fjr_msgs_py.console.output import number, percent

Formatter = Callable[[float, str], str]  # (value, unit) -> text


_four_digits = partial(number, digits=4)


def peak_effort(report: Report, write: Formatter = _four_digits) -> str:
    """Return the peak effort, e.g. 43.1 N m (joint2)."""
    tracking = report.tracking
    unit = report.of_joint(tracking.peak_effort_joint).effort_unit
    return write(tracking.peak_effort_nm, unit) + _of(report, tracking.peak_effort_joint)


def effort_share(report: Report) -> str:
    """Return the largest share of an effort limit, e.g. 68 % of its limit (joint4); empty without limits."""
    share = report.tracking.largest_share_of_effort_limit
    return (
        "" if share is None else f"{percent(share, 0)} of its limit" + _of(report, report.tracking.largest_share_joint)
    )


def peak_effort_and_share(report: Report, write: Formatter = _four_digits) -> str:
    """Return both, e.g. 43.1 N m (joint2), 68 % of its limit (joint4)."""
    return ", ".join(filter(None, (peak_effort(report, write), effort_share(report))))


def steady_error(report: Report, write: Formatter = number) -> str:
    """Return the largest error after 2 s, e.g. 1.4e-4 rad (joint2)."""
    tracking = report.tracking
    if tracking.max_error_after_2s_rad is None:
        return write(float("nan"), "")
    unit = report.of_joint(tracking.max_error_after_2s_joint).position_unit
    return write(tracking.max_error_after_2s_rad, unit) + _of(report, tracking.max_error_after_2s_joint)


def initial_error(report: Report) -> str:
    """Return the largest initial error, e.g. 0.5 rad (joint2)."""
    worst = max(report.joints, key=lambda each: each.initial_error_rad)
    return number(worst.initial_error_rad, worst.position_unit) + _of(report, worst.joint)


def position_unit(report: Report) -> str:
    """Return the position unit of the joints: rad, m, or both."""
    return joined(each.position_unit for each in report.joints)


def effort_unit(report: Report) -> str:
    """Return the effort unit of the joints: N m, N, or both."""
    return joined(each.effort_unit for each in report.joints)


def _of(report: Report, joint: str | None) -> str:
    return f" ({joint})" if joint and len(report.joints) > 1 else ""
