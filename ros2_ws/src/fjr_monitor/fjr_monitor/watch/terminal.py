# SPDX-License-Identifier: Apache-2.0
"""Render a View for a terminal; pure functions of view and width."""

from __future__ import annotations

import math

from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from fjr_monitor.watch.state import LEVELS, JointLine, NodeHealth, View
from fjr_msgs_py.console.output import percent, printable

ERROR_DECADES = (-6.0, 0.0)  # log10 of rad, at an empty and a full bar
WIDE, NARROW = 118, 80  # characters, for all columns, and for bars
BLOCKS = " ▏▎▍▌▋▊▉█"
SPARKS = "▁▂▃▄▅▆▇█"
ERROR_BAR, EFFORT_BAR = 16, 17  # characters
NARROW_ERROR_BAR, NARROW_EFFORT_BAR = 8, 11
SILENT = 1.0  # s without a state
NEAR, AT = 0.8, 0.999  # of a limit
COLOURS = {"ok": "green", "warn": "yellow", "error": "red", "stale": "magenta"}
NOTHING = "-"
COLUMNS = "joint", "q_l rad", "dq_l rad/s", "q_m-q_l mrad", "error mrad", "1e-3..1e3", "u N m", "-lim..+lim", "of limit"
NAME, POSITION, VELOCITY, DEFLECTION, ERROR, ERRORS, EFFORT, EFFORTS, SHARE = COLUMNS
HISTORY, BESIDE = 60, 34  # characters of the sparkline, and of what stands beside it
LEAST = 1e-20  # J or W; smaller amounts, such as the bound of V after some seconds, are not told apart
LARGE = 1e-2  # rad, of an error
CERTIFICATE = dict.fromkeys(("V", "bound", "H"), "J")  # units by label, in the order of the display
CERTIFICATE |= dict.fromkeys(("dV_measured", "dV_predicted", "supplied", "dissipated"), "W")


def render(view: View, width: int = WIDE) -> RenderableType:
    """Render the whole view; below WIDE characters without velocities and deflections, below NARROW without bars."""
    joints = _joints(view.joints, width)
    parts: list[RenderableType] = [_header(view), joints, _certificate(view, width), _health(view)]
    if view.events:
        parts.append(_events(view))
    if view.missing:
        parts.append(Text(f"no publisher of {', '.join(view.missing)}", style="dim"))
    return Group(*parts)


def log_bar(value: float, width: int) -> str:
    """Return a logarithmic bar of a magnitude."""
    low, high = ERROR_DECADES
    share = (math.log10(value) - low) / (high - low) if value > 0 else 0.0
    whole, rest = divmod(round(8 * width * min(1.0, max(0.0, share))), 8)
    return ("█" * whole + (BLOCKS[rest] if rest else "")).ljust(width)


def signed_bar(value: float, largest: float, width: int) -> str:
    """Return a bar from the centre to the left (negative) or right, full at +-largest."""
    half = width // 2
    length = min(half, round(half * min(1.0, abs(value) / largest))) if largest > 0 and math.isfinite(value) else 0
    left = ("█" * length if value < 0 else "").rjust(half)
    right = ("█" * length if value > 0 else "").ljust(half)
    return f"{left}│{right}"


def sparkline(values: tuple[float, ...], width: int) -> str:
    """Return a sparkline of positive values on a logarithmic scale, the newest on the right."""
    logs = [math.log10(v) if v > 0 else -300.0 for v in values[-width:] if math.isfinite(v)]
    if not logs:
        return ""
    high = max(logs)
    low = min(min(logs), high - 1.0)
    steps = len(SPARKS) - 1
    return "".join(SPARKS[round(steps * (v - low) / (high - low))] for v in logs)


def _header(view: View) -> Text:
    line = Text().append(view.title, style="bold")
    if view.silence is None:
        return line.append("   waiting for joint states", style="yellow")
    if view.silence > SILENT:
        return line.append(f"   no state for {view.silence:.1f} s", style="bold red")
    timing = view.timing
    if timing is None:
        return line
    line.append(f"   {timing.rate:.1f} states/s", style="green")
    line.append(f"   period {_ms(timing.period)}")
    if timing.latency:
        line.append(f"   state to command {_ms(timing.latency)}")
    if timing.latency or timing.unanswered:
        line.append(f"   unanswered {timing.unanswered}", style="red" if timing.unanswered else "default")
    return line


def _ms(values: tuple[float, float, float]) -> str:
    return f"{'/'.join(f'{1e3 * value:.2f}' for value in values)} ms"


def _joints(joints: tuple[JointLine, ...], width: int) -> Panel:
    table = Table(box=None, expand=False, pad_edge=False)
    bars = (ERROR_BAR, EFFORT_BAR) if width >= WIDE else (NARROW_ERROR_BAR, NARROW_EFFORT_BAR)
    hidden = (VELOCITY, DEFLECTION) * (width < WIDE) + (ERRORS, EFFORTS) * (width < NARROW)
    shown = [column for column in COLUMNS if column not in hidden]
    for heading in shown:
        right = heading not in (NAME, ERRORS, EFFORTS)
        named = heading == NAME  # only names give way to a narrow terminal, in lines
        table.add_column(heading, justify="right" if right else "left", no_wrap=not named, overflow="fold")
    for joint in joints:
        cells = _cells(joint, *bars)
        table.add_row(*(cells[heading] for heading in shown))
    title = "joints (period and latency: 50 %/99 %/max of 2 s)"
    return Panel(table, title=title, title_align="left", border_style="dim")


def _cells(joint: JointLine, error_bar: int, effort_bar: int) -> dict[str, RenderableType]:
    """Return the cell of each column; error_bar, effort_bar: width in characters."""
    error = None if joint.error is None else abs(joint.error)
    share = None if joint.effort is None or not joint.limit else abs(joint.effort) / joint.limit
    error_style = "yellow" if (error or 0) > LARGE else "green"
    effort_style = "red" if (share or 0) >= AT else "yellow" if (share or 0) >= NEAR else "cyan"
    efforts = "" if joint.effort is None else signed_bar(joint.effort, joint.limit or joint.peak, effort_bar)
    return {
        NAME: Text(printable(joint.name) + " [m, mm, N]" * joint.prismatic, style="bold"),
        POSITION: _signed(joint.position),
        VELOCITY: _signed(joint.velocity),
        DEFLECTION: NOTHING if joint.deflection is None else f"{1e3 * joint.deflection:+.2f}",
        ERROR: NOTHING if error is None else f"{1e3 * error:.3g}",
        ERRORS: Text("" if error is None else log_bar(error, error_bar), style=error_style),
        EFFORT: NOTHING if joint.effort is None else f"{joint.effort:+.3f}",
        EFFORTS: Text(efforts, style=effort_style),
        SHARE: f"peak {joint.peak:.3g}" if share is None else percent(share, 0),
    }


def _signed(value: float | None) -> str:
    return NOTHING if value is None else f"{value:+.4f}"


def _certificate(view: View, width: int) -> Panel:
    """Render the numbers of the certificate, a sparkline of V with the range of its values, and the diagnosis."""
    diagnoses = [_status(status) for status in view.health if "certificate" in status.name]
    if view.certificate is None:
        parts: list[RenderableType] = [Text("no certificate received", style="dim")]
    else:
        values = view.certificate
        numbers = [
            f"{key.replace('dV_', 'dV/dt ')} {_amount(values[key], unit)}"
            for key, unit in CERTIFICATE.items()
            if key in values and not (key == "bound" and values[key] < 0)  # negative: no bound
        ]
        finite = [value for value in view.history if math.isfinite(value)]
        line = Text("log V  ").append(sparkline(view.history, max(1, min(HISTORY, width - BESIDE))), style="cyan")
        if finite:
            line.append(f"  {min(finite):.0e} .. {max(finite):.0e} J", style="dim")
        parts = [Columns(numbers, padding=(0, 3)), line]
    return Panel(Group(*parts, *diagnoses), title="certificate", title_align="left", border_style="dim")


def _amount(value: float, unit: str) -> str:
    if not math.isfinite(value):
        return NOTHING
    return f"below {LEAST:g} {unit}" if 0 < abs(value) < LEAST else f"{value:.3g} {unit}"


def _health(view: View) -> Panel:
    lines = [_status(status) for status in view.health if "certificate" not in status.name]
    content = Text("\n").join(lines) if lines else Text("no diagnostics received", style="dim")
    return Panel(content, title="health", title_align="left", border_style="dim")


def _status(status: NodeHealth) -> Text:
    level = LEVELS[min(status.level, len(LEVELS) - 1)]
    line = Text().append(f"{level:5} ", style=f"bold {COLOURS[level]}").append(printable(status.name))
    state = f" [{status.state}]" if status.state else ""
    return line.append(printable(f"{state}  {status.message}"))


def _events(view: View) -> Panel:
    lines = []
    for event in view.events:
        level = LEVELS[min(event.level, len(LEVELS) - 1)]
        line = Text().append(f"{event.age:6.1f} s ago  ", style="dim")
        line.append(printable(event.kind), style=f"bold {COLOURS[level]}")
        lines.append(line.append(printable(f"  {event.sentence}")))
    return Panel(Text("\n").join(lines), title="events", title_align="left", border_style="dim")
