# SPDX-License-Identifier: Apache-2.0
"""Mapping file of a record: which column, or which field of the messages, measures what of which joint.

For tables, with one column per joint; `{joint}` stands for the joint's name, lists have one entry per joint:

    time: {column: time_s, unit: s}
    link_position: {column: "{joint}_link", unit: deg, joints: [a1, a2]}    # joints: those that have it, default all
    motor_position: {column: [m1, m2, m3], unit: turn, gear_ratio: [100, 100, 80], sign: [1, -1, 1]}
    effort: {column: "{joint}_torque", unit: N m, gear_ratio: 100}          # of the motor; at its shaft with gear_ratio
    joint_torque: {column: "{joint}_sensor", unit: N m}                     # a torque sensor between gear and link

For bags: `bag: {namespace: /left, motor: position, gear_ratio: [100, 100, 80], effort: commands}`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config import ros_yaml
from fjr_core.errors import ParameterError
from fjr_core.numerics.checks import Array

ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turn": 2 * math.pi, "m": 1.0, "mm": 1e-3}
TORQUES = {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "kN m": 1e3, "N": 1.0, "kN": 1e3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LINK, MOTOR, EFFORT, TORQUE = "link_position", "motor_position", "effort", "joint_torque"
UNITS = {LINK: ANGLES, MOTOR: ANGLES, EFFORT: TORQUES, TORQUE: TORQUES}
KEYS = ("column", "unit", "joints", "gear_ratio", "sign")
BY_COMMANDS, BY_STATES = "commands", "states"
BAG_KEYS = {"namespace": (str,), "motor": (str,), "gear_ratio": (int, float, list), "effort": (str,)}


@dataclass(frozen=True)
class TableColumn:
    """A column of a table; its numbers times `factor` are SI units at the joint side."""

    name: str
    factor: float


@dataclass(frozen=True)
class TableMap:
    """Columns of a table: time, and by signal and joint."""

    time: TableColumn
    signals: Mapping[str, Mapping[str, TableColumn]]
    delimiter: str = ","

    @property
    def columns(self) -> list[str]:
        """Return the names of all columns, each once."""
        named = [column.name for of_joint in self.signals.values() for column in of_joint.values()]
        return list(dict.fromkeys([self.time.name, *named]))


@dataclass(frozen=True, eq=False)
class BagMap:
    """Meaning of the messages of a bag, as measurement.* of a scenario (docs/measurements.md).

    namespace: of the topics. by_torque: the link's effort is a torque sensor and there is no motor position.
    gear_ratio (n,): motor angle in the messages per turn of q_m. effort: from the commands or from the states' motors;
    "": from the commands if there are any.
    """

    gear_ratio: Array
    namespace: str = ""
    by_torque: bool = False
    effort: str = ""


def read_map(path: Path, joints: Sequence[str]) -> TableMap | BagMap:
    """Return the mapping in a YAML file for the joints of a robot; raise ParameterError, which names the file."""
    document = ros_yaml.read(path, "mapping file")
    try:
        if not isinstance(document, dict):
            raise ParameterError(f"holds a {type(document).__name__}; expected a mapping")
        return _bag(document, len(joints)) if "bag" in document else _table(document, joints)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def _bag(document: Mapping[Any, Any], n: int) -> BagMap:
    given = document["bag"]
    if not isinstance(given, dict) or len(document) > 1:
        raise ParameterError(f"'bag' is {given!r}, beside {len(document) - 1} other keys; expected one mapping")
    for key, value in given.items():
        if key not in BAG_KEYS or not isinstance(value, BAG_KEYS[key]):
            raise ParameterError(f"'bag' has {key}: {value!r}; expected {', '.join(BAG_KEYS)}")
    motor, effort = given.get("motor", "position"), given.get("effort", "")
    if motor not in ("position", "torque"):
        raise ParameterError(f"bag.motor is {motor!r}; expected position or torque")
    if effort not in ("", BY_COMMANDS, BY_STATES):
        raise ParameterError(f"bag.effort is {effort!r}; expected {BY_COMMANDS} or {BY_STATES}")
    namespace = str(given.get("namespace", "")).strip("/")
    ratio = _numbers("bag.gear_ratio", given.get("gear_ratio", 1.0), n)
    return BagMap(ratio, f"/{namespace}" if namespace else "", motor == "torque", effort)


def _table(document: Mapping[Any, Any], joints: Sequence[str]) -> TableMap:
    unknown = [key for key in document if key not in ("time", "delimiter", *UNITS)]
    if unknown:
        raise ParameterError(f"holds '{unknown[0]}'; expected time, {', '.join(UNITS)}, delimiter or bag")
    if "time" not in document or EFFORT not in document:
        raise ParameterError(f"has no '{'effort' if 'time' in document else 'time'}'; expected its column and unit")
    time = _entry("time", document["time"], ("column", "unit"))
    if not isinstance(time["column"], str):
        raise ParameterError(f"time.column is {time['column']!r}; expected the name of a column")
    scale = _unit("time", time, TIMES, "s")
    signals = {name: _signal(name, document[name], joints) for name in UNITS if name in document}
    for joint in joints:
        if joint not in signals[EFFORT]:
            raise ParameterError(f"joint {joint} has no effort; expected a column for each joint of the robot")
        if not any(joint in signals.get(name, {}) for name in (LINK, MOTOR)):
            raise ParameterError(f"joint {joint} has neither {LINK} nor {MOTOR}; expected at least one")
    delimiter = document.get("delimiter", ",")
    if not isinstance(delimiter, str) or len(delimiter) != 1:
        raise ParameterError(f"delimiter is {delimiter!r}; expected one character")
    return TableMap(TableColumn(time["column"], scale), signals, delimiter)


def _signal(name: str, given: Any, joints: Sequence[str]) -> dict[str, TableColumn]:
    """Return the columns of a signal by joint."""
    entry = _entry(name, given, KEYS)
    listed = entry.get("joints", list(joints))
    if not isinstance(listed, list) or not set(listed) <= set(joints):
        raise ParameterError(f"{name}.joints is {listed!r}; expected some of {', '.join(joints)}")
    columns, n = entry["column"], len(listed)
    if isinstance(columns, str):
        columns = [columns.replace("{joint}", joint) for joint in listed]
    if not isinstance(columns, list) or len(columns) != n or not all(isinstance(column, str) for column in columns):
        raise ParameterError(f"{name}.column is {columns!r}; expected {n} names, or one with {{joint}}")
    if len(set(columns)) < len(columns):
        raise ParameterError(f"{name}.column names a column twice; expected one per joint, as in '{{joint}}_position'")
    scale = _unit(name, entry, UNITS[name], "")
    ratio, sign = (_numbers(f"{name}.{key}", entry.get(key, 1.0), n) for key in ("gear_ratio", "sign"))
    if not set(sign) <= {-1.0, 1.0}:
        raise ParameterError(f"{name}.sign is {entry['sign']!r}; expected 1 or -1")
    factor = scale * sign * (1.0 / ratio if UNITS[name] is ANGLES else ratio)
    return {
        joint: TableColumn(column, float(to_si)) for joint, column, to_si in zip(listed, columns, factor, strict=True)
    }


def _entry(name: str, given: Any, keys: Sequence[str]) -> Mapping[str, Any]:
    """Return a mapping that has a column and known keys only."""
    if not isinstance(given, dict) or "column" not in given:
        raise ParameterError(f"'{name}' is {given!r}; expected a mapping with a column and a unit")
    unknown = [key for key in given if key not in keys]
    if unknown:
        raise ParameterError(f"'{name}' has '{unknown[0]}'; expected {', '.join(keys)}")
    return given


def _unit(name: str, entry: Mapping[str, Any], units: Mapping[str, float], default: str) -> float:
    unit = entry.get("unit", default)
    if unit not in units:
        raise ParameterError(f"{name}.unit is {unit!r}; expected one of {', '.join(units)}")
    return units[unit]


def _numbers(name: str, value: Any, n: int) -> Array:
    """Return one or n numbers as (n,), none of them 0."""
    listed = value if isinstance(value, list) else [value] * n
    good = [isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) and x != 0 for x in listed]
    if len(listed) != n or not all(good):
        raise ParameterError(f"{name} is {value!r}; expected a number other than 0, or {n} of them")
    return np.array(listed, dtype=float)
