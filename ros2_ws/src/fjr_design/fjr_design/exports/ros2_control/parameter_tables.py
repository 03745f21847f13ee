# SPDX-License-Identifier: Apache-2.0
"""Parameters of the exported controller and arm: tables for their C++ sources and for their README."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.numerics.parameter_field import Parameter, declared
from fjr_core.runtime.events import ERRORS, KINDS, SENTENCES, WARNINGS
from fjr_core.runtime.safety_settings import Settings

from ..c_code import number, quoted
from ..step_code import Controller
from .arm import DYNAMICS, SENSORS, Arm

NAMES = (
    ("joints", "the scenario's", "state interfaces of the links: `<joint>/position`, `<joint>/velocity`"),
    ("motors", "`<joint>_motor`", "state interfaces of the motors: `<motor>/position`, `<motor>/velocity`"),
    ("command_joints", "`<joint>_motor`", "command interfaces: `<command_joint>/effort`"),
    ("stamp_interface", "none", "state interface with the time of the measurement in ns; none: the time of the update"),
    ("publish_rate", "100 Hz", "largest rate of `~/certificate`"),
)


def gain_table(controller: Controller) -> dict[str, str]:
    """Return the rows of the gains that may be changed, and the index of K_md among them.

    Gains of v-dPBC only. A full matrix Pi_m is left out, because the law needs its inverse.
    """
    law = controller.certified_law
    if law is None:
        return {"gain_table": "", "hold_damping_gain": "-1"}
    first, starts = 0, {}
    for name, symbol in law.symbols.by_name.items():
        starts[name] = first, symbol.nnz()
        first += symbol.nnz()
    inverse = starts.pop("Pi_m_inverse")
    if inverse[1] != controller.n:
        del starts["Pi_m"]
    rows = [(name, *start, inverse[0] if name == "Pi_m" else -1) for name, start in starts.items()]
    text = ",\n  ".join(f"{{{quoted(name)}, {start}, {length}, {at}}}" for name, start, length, at in rows)
    return {"gain_table": f"\n  {text}", "hold_damping_gain": str([row[0] for row in rows].index("K_md"))}


def event_table() -> str:
    """Return name and level of each kind of event as C++."""
    levels = ("error" if name in ERRORS else "warn" if name in WARNINGS else "info" for name in KINDS)
    return ",\n".join(f"  {{{quoted(name)}, Level::{level}}}" for name, level in zip(KINDS, levels, strict=True))


def wiring_table() -> str:
    """Return the sentence of each kind of wiring fault as C++."""
    return ",\n".join(f"  {quoted(sentence)}" for sentence in SENTENCES.values())


def plant_table(arm: Arm) -> str:
    """Return name, place, length and least value of each parameter of the plant as C++."""
    rows = (f"  {{{quoted(name)}, {first}, {length}, {_bound(least)}}}" for name, first, length, least in arm.table)
    return ",\n".join(rows)


def controller_rows() -> str:
    """Return the rows of the README for the parameters of the controller."""
    safety = _rows(declared(Settings).values())
    return "\n".join([*(f"| `{name}` | {default} | {text} |" for name, default, text in NAMES), *safety])


def arm_rows() -> str:
    """Return the rows of the README for the parameters of the arm."""
    return "\n".join(_rows([*DYNAMICS.values(), *SENSORS.values()], show_default=True))


def _rows(parameters: Iterable[Parameter], show_default: bool = False) -> Iterable[str]:
    for each in parameters:
        unit = f" [{each.unit}]" if each.unit else ""
        default = f"{_shown(each.default)}" if show_default else "the scenario's"
        description = each.description.replace("|", "\\|")
        yield f"| `{each.name}` | {default} | {description}{unit} |"


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _bound(value: ArrayLike) -> str:
    """Format a bound for C++, in which INFINITY is a float."""
    return number(float(value)) if np.isfinite(value) else "-std::numeric_limits<double>::infinity()"  # type: ignore[arg-type]
