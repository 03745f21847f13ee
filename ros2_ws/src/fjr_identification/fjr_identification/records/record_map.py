# SPDX-License-Identifier: Apache-2.0
"""Mapping file of a record: which column, or which field of the messages, measures what of which joint.

For tables, with one column per joint; `{joint}` stands for the joint's name, lists have one entry per joint:

    time: {column: time_s, unit: s}
    link_position: {column: "{joint}_link", unit: deg, joints: [a1, a2]}    # joints: those that have it, default all
    motor_position: {column: [m1, m2, m3], unit: turn, gear_ratio: [100, 100, 80], sign: [1, -1, 1]}
    effort: {column: "{joint}_torque", unit: N m, gear_ratio: 100}          # of the motor; at its shaft with gear_ratio
    joint_torque: {column: "{joint}_sensor", unit: [N m, N]}                # a sensor between gear and link; a list

For bags: `bag: {namespace: /left, motor: position, gear_ratio: [100, 100, 80], effort: states}`.

`fjr identify LOG --write-map` proposes a mapping file of a table. It splits the name of a column into words:

    a1_motor_torque_nm = joint a1, signal effort, unit N m

Words of UNIT, SIGNAL and SIDE give unit and signal; the words that remain are the joint. What no word gives is marked
FILL_IN, which the reader of mapping files refuses until it is replaced.
"""

from __future__ import annotations

import csv
import gzip
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config import ros_yaml
from fjr_core.errors import LONGEST, PIP, MissingPackageError, ParameterError, RecordError, prefixed
from fjr_core.numerics.checks import Array

ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turn": 2 * math.pi, "m": 1.0, "mm": 1e-3}
OF_SLIDES = {"m", "mm", "N", "kN"}
TORQUES = {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "kN m": 1e3, "N": 1.0, "kN": 1e3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LINK, MOTOR, EFFORT, TORQUE = "link_position", "motor_position", "effort", "joint_torque"
UNITS = {LINK: ANGLES, MOTOR: ANGLES, EFFORT: TORQUES, TORQUE: TORQUES}
KEYS = ("column", "unit", "joints", "gear_ratio", "sign")
HELD = "control_period"
BAG_KEYS = {"namespace": (str,), "motor": (str,), "gear_ratio": (int, float, list), "effort": (str,), HELD: (object,)}
CHOICES = {"motor": ("position", "torque"), "effort": ("commands", "states")}
"""Of keys of a bag; the first one is the default."""

PARQUET = ".parquet"
HEADER_LINES = 1000  # empty lines and comments before the header, at most
SLOWEST = 0.1  # s; period of no controller of joints: 1 or 0.5 are milliseconds
FILL_IN = "FILL_IN"
TIME, POSITION = "time", "position"
UNIT = {
    **{word: word for word in ("rad", "mrad", "deg", "turn", "mm", "s", "ms", "us", "ns", "kn")},
    **{"degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "rev": "turn", "turns": "turn"},
    **{"nm": "N m", "mnm": "mN m", "knm": "kN m", "kn": "kN", "sec": "s", "seconds": "s"},
}
"""Unit of a word; m and n alone are units only at the end of a name, where N m may be two words."""
TIME_WORDS = {"time", "timestamp", "stamp", "t"}
IGNORED = {"reference", "ref", "ld", "desired", "des", "setpoint", "target", "velocity", "vel", "speed", "dq", "qd"}
IGNORED |= {"rpm", "acceleration", "acc", "ddq", "current", "temperature", "temp", "error", "err", "state", "status"}
EFFORTS = {"torque", "effort", "tau", "trq", "u", "force", "moment"}
POSITIONS = {"position", "pos", "angle", "q", "theta", "encoder", "enc"}
SIDES = {MOTOR: {"motor", "rotor", "qm", "m"}, LINK: {"link", "load", "output", "secondary", "ql", "l"}}
SENSORS = {"sensor", "measured", "ext", "jts"}


@dataclass(frozen=True)
class TableColumn:
    """A column of a table; its numbers times `factor` are SI units at the joint side."""

    name: str
    factor: float


@dataclass(frozen=True)
class TableMap:
    """Columns of a table: time, and by signal and joint. held [s]: how long the controller holds an effort."""

    time: TableColumn
    signals: Mapping[str, Mapping[str, TableColumn]]
    delimiter: str = ","
    held: float = math.inf

    @property
    def columns(self) -> list[str]:
        """Return the names of all columns, each once."""
        named = [column.name for of_joint in self.signals.values() for column in of_joint.values()]
        return list(dict.fromkeys([self.time.name, *named]))


@dataclass(frozen=True, eq=False)
class BagMap:
    """Meaning of the messages of a bag, as measurement.* of a scenario (docs/measurements.md).

    namespace: of the topics. by_torque: the link's effort is a torque sensor and there is no motor position.
    gear_ratio (n,): motor angle in the messages per turn of q_m. by_states: the effort is that of the motors in the
    states, although there may be commands. held [s]: how long the controller holds an effort, inf: not known.
    """

    gear_ratio: Array
    namespace: str = ""
    by_torque: bool = False
    by_states: bool = False
    held: float = math.inf


def read_map(path: Path, joints: Sequence[str]) -> TableMap | BagMap:
    """Return the mapping in a YAML file for the joints of a robot; raise ParameterError, which names the file."""
    document = ros_yaml.read(path, "mapping file")
    with prefixed(f"{path}: "):
        given = ros_yaml.mapping(document)
        return _bag(given, len(joints)) if "bag" in given else _table(given, joints)


def _bag(document: Mapping[Any, Any], n: int) -> BagMap:
    given = document["bag"]
    if not isinstance(given, dict) or len(document) > 1:
        raise ParameterError(f"'bag' is {given!r}, beside {len(document) - 1} other keys; expected one mapping")
    for key, value in given.items():
        if key not in BAG_KEYS or not isinstance(value, BAG_KEYS[key]):
            raise ParameterError(f"'bag' has {key}: {value!r}; expected {', '.join(BAG_KEYS)}")
    for key, choices in CHOICES.items():
        if given.get(key, choices[0]) not in choices:
            raise ParameterError(f"bag.{key} is {given[key]!r}; expected {' or '.join(choices)}")
    by_torque, by_states = (given.get(key) == choices[1] for key, choices in CHOICES.items())
    namespace = str(given.get("namespace", "")).strip("/")
    ratio = _numbers("bag.gear_ratio", given.get("gear_ratio", 1.0), n)
    return BagMap(ratio, f"/{namespace}" if namespace else "", by_torque, by_states, _period("bag.", given))


def _table(document: Mapping[Any, Any], joints: Sequence[str]) -> TableMap:
    unknown = [key for key in document if key not in ("time", "delimiter", HELD, *UNITS)]
    if unknown:
        raise ParameterError(f"holds '{unknown[0]}'; expected time, {', '.join(UNITS)}, delimiter, {HELD} or bag")
    if "time" not in document or EFFORT not in document:
        raise ParameterError(f"has no '{'effort' if 'time' in document else 'time'}'; expected its column and unit")
    time = _entry("time", document["time"], ("column", "unit"))
    if not isinstance(time["column"], str):
        raise ParameterError(f"time.column is {time['column']!r}; expected the name of a column")
    (scale,) = _units("time", time, TIMES, "s", 1)
    signals = {name: _signal(name, document[name], joints) for name in UNITS if name in document}
    for joint in joints:
        if joint not in signals[EFFORT]:
            raise ParameterError(f"joint {joint} has no effort; expected a column for each joint of the robot")
        if not any(joint in signals.get(name, {}) for name in (LINK, MOTOR)):
            raise ParameterError(f"joint {joint} has neither {LINK} nor {MOTOR}; expected at least one")
    delimiter = document.get("delimiter", ",")
    if not isinstance(delimiter, str) or len(delimiter) != 1:
        raise ParameterError(f"delimiter is {delimiter!r}; expected one character")
    return TableMap(TableColumn(time["column"], float(scale)), signals, delimiter, _period("", document))


def _period(prefix: str, given: Mapping[Any, Any]) -> float:
    """Return the period of the controller [s], inf if it is not given."""
    value = given.get(HELD, math.inf)
    is_period = isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < SLOWEST
    if HELD in given and not is_period:
        raise ParameterError(f"{prefix}{HELD} is {value!r}; expected seconds above 0 and below {SLOWEST:g}")
    return float(value)


def _signal(name: str, given: Any, joints: Sequence[str]) -> dict[str, TableColumn]:
    """Return the columns of a signal by joint."""
    entry = _entry(name, given, KEYS)
    listed = entry.get("joints", list(joints))
    if not isinstance(listed, list) or not set(listed) <= set(joints):
        raise ParameterError(f"{name}.joints is {listed!r}; expected some of {', '.join(joints)}")
    columns, n = entry["column"], len(listed)
    if FILL_IN in columns:
        raise ParameterError(f"{name}.column is {FILL_IN}; expected the columns of {', '.join(map(str, listed))}")
    if isinstance(columns, str):
        columns = [columns.replace("{joint}", joint) for joint in listed]
    if not isinstance(columns, list) or len(columns) != n or not all(isinstance(column, str) for column in columns):
        raise ParameterError(f"{name}.column is {columns!r}; expected {n} names, or one with {{joint}}")
    if len(set(columns)) < len(columns):
        raise ParameterError(f"{name}.column names a column twice; expected one per joint, as in '{{joint}}_position'")
    scale = _units(name, entry, UNITS[name], "", n)
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


def _units(name: str, entry: Mapping[str, Any], units: Mapping[str, float], default: str, n: int) -> Array:
    """Return the factors (n,) to SI units of one unit for all columns, or of a list."""
    given = entry.get("unit", default)
    listed = given if isinstance(given, list) else [given] * n
    if len(listed) != n or not all(isinstance(unit, str) and unit in units for unit in listed):
        expected = f"one of {', '.join(units)}" + (f", or a list of {n}" if n > 1 else "")
        raise ParameterError(f"{name}.unit is {given!r}; expected {expected}")
    return np.array([units[unit] for unit in listed])


def _numbers(name: str, value: Any, n: int) -> Array:
    """Return one or n numbers as (n,), none of them 0."""
    listed = value if isinstance(value, list) else [value] * n
    good = [isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) and x != 0 for x in listed]
    if len(listed) != n or not all(good):
        raise ParameterError(f"{name} is {value!r}; expected a number other than 0, or {n} of them")
    return np.array(listed, dtype=float)


def arrow() -> Any:
    """Return pyarrow with its readers, loaded on use: a bag needs none of them. Raises MissingPackageError."""
    try:
        import pyarrow.csv
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise MissingPackageError(f"pyarrow is not installed; expected it for tables: {PIP} pyarrow") from None
    return pyarrow


def header_of(path: Path, delimiter: str) -> tuple[int, list[str]]:
    """Return the number of lines before the header of a CSV file, and the names in it; raises RecordError, OSError."""
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8-sig", newline="") as stream:
        for number in range(HEADER_LINES):
            line = stream.readline(2**20)
            if line.strip() and not line.lstrip().startswith("#"):
                return number, [name.strip() for name in next(csv.reader([line], delimiter=delimiter))]
    raise RecordError(f"{path} has no header; expected the names of the columns in the first line")


@dataclass(frozen=True)
class Meaning:
    """What the name of a column says; "" where it says nothing. signal: also POSITION, of an unknown side."""

    column: str
    signal: str = ""
    joint: str = ""
    unit: str = ""


def written_map(table: Path, joints: Sequence[str]) -> tuple[str, list[str]]:
    """Return the text of a mapping file for a table, and a line for each thing to fill in or to check.

    joints: of the robot file, empty without one. Raises RecordError for a table without header or without positions.
    """
    delimiter, header = _delimiter_and_names(table)
    meanings = [_meaning(column, joints) for column in header]
    if joints and {meaning.joint for meaning in meanings} & set(joints):  # columns of other joints are of no use
        meanings = [m if m.joint in ("", *joints) else Meaning(m.column) for m in meanings]
    by_signal = {name: [m for m in meanings if m.signal == name] for name in (*UNITS, POSITION)}
    if not any(by_signal.values()):
        raise RecordError(
            f"{table}: no name of a column says position or torque ({', '.join(header)[: LONGEST // 4]}); expected "
            "names such as a1_motor_rad and a1_motor_torque_nm, or a mapping file written by hand"
        )
    time = next((m for m in meanings if m.signal == TIME), Meaning(FILL_IN))
    todo = [] if time.signal else ["fill in  time.column: no column was recognised"]
    todo += [] if time.unit else ["fill in  time.unit: s, ms, us or ns"]
    document: dict[str, Any] = {} if delimiter == "," else {"delimiter": delimiter}
    document["time"] = {"column": time.column, "unit": time.unit or FILL_IN}
    if by_signal[POSITION]:
        todo.append(
            f"fill in  whether {_few(by_signal[POSITION])} are {MOTOR} or {LINK}: replace {FILL_IN} by one of them"
        )
    for signal, columns in by_signal.items():
        if columns:
            name = FILL_IN if signal == POSITION else signal
            document[name] = _proposed(name, columns, joints, todo)
    if not by_signal[EFFORT]:
        document[EFFORT] = {"column": FILL_IN, "unit": FILL_IN}
        todo.append(f"fill in  {EFFORT}: no column was recognised (currents: gear_ratio is N m of the joint per A)")
    unused = [m.column for m in meanings if not m.signal or (m.signal == TIME and m != time)]
    head = (
        f"# Columns of {table.name}, by `fjr identify --write-map`; docs/from_csv.md explains the keys.\n"
        "# gear_ratio: motor turns per joint turn, if the columns count at the motor's shaft.\n"
    )
    return head + ros_yaml.dump(document) + (f"# not used: {', '.join(unused)}\n" if unused else ""), todo


def _proposed(signal: str, columns: Sequence[Meaning], joints: Sequence[str], todo: list[str]) -> dict[str, Any]:
    """Return the entry of a signal and add what is missing to `todo`."""
    units = [meaning.unit for meaning in columns]
    revolute, prismatic = set(units) - OF_SLIDES, set(units) & OF_SLIDES
    unit = units[0] if len(set(units)) == 1 else units if all(units) and len(revolute) == len(prismatic) == 1 else ""
    if not unit:
        possible = ANGLES if signal in (FILL_IN, LINK, MOTOR) else UNITS[EFFORT]
        todo.append(f"fill in  {signal}.unit of {_few(columns)}: {', '.join(possible)}")
    said = [meaning.joint for meaning in columns]
    distinct = all(said) and len(set(said)) == len(said)
    named = said if distinct and set(said) <= set(joints or said) else []
    if not named and joints and len(said) == len(joints):
        named = list(joints)
        todo.append(f"check    {signal}: {_few(columns)} are taken for {', '.join(joints)} in this order")
    if not named:
        todo.append(f"fill in  {signal}.joints of {_few(columns)}: one joint of the robot file for each, in order")
    patterns = {m.column.replace(joint, "{joint}", 1) for m, joint in zip(columns, named, strict=False)}
    entry: dict[str, Any] = {"column": patterns.pop() if len(patterns) == 1 else [m.column for m in columns]}
    if not named or named != list(joints):
        entry["joints"] = named or FILL_IN
    entry["unit"] = unit or FILL_IN
    if signal in (FILL_IN, MOTOR, EFFORT):
        entry["gear_ratio"] = 1.0
        todo.append(f"check    {signal}.gear_ratio is 1: {_few(columns)} count at the joint's side")
    return entry


def _meaning(column: str, joints: Sequence[str]) -> Meaning:
    """Return what the name of a column says."""
    words, joint = _words(column), ""
    for name in sorted(joints, key=len, reverse=True):
        part = _words(name)
        starts = [i for i in range(len(words) - len(part) + 1) if words[i : i + len(part)] == part]
        if starts:
            joint, words = name, [*words[: starts[0]], *words[starts[0] + len(part) :]]
            break
    unit, words = _unit_of(words)
    said = set(words)
    rate = unit in TIMES and not said & TIME_WORDS  # such as rad/s
    if rate or said & IGNORED or ("external" in said and said & EFFORTS):  # an estimate of `fjr report --table`
        return Meaning(column)
    if said & TIME_WORDS and not said & (EFFORTS | POSITIONS):
        return Meaning(column, TIME, "", unit)
    side = next((side for side, names in SIDES.items() if said & names), "")
    if said & EFFORTS or unit in UNITS[EFFORT]:
        signal = TORQUE if said & SENSORS or side == LINK else EFFORT
    elif said & POSITIONS or side or unit in ANGLES:
        signal = side or POSITION
    else:
        return Meaning(column)
    kept = [word for word in words if word not in EFFORTS | POSITIONS | SENSORS | SIDES[MOTOR] | SIDES[LINK]]
    return Meaning(column, signal, joint or "_".join(kept), unit)


def _words(text: str) -> list[str]:
    """Split a name at everything but letters and digits and before capitals, and letters of symbols from numbers."""
    symbols = EFFORTS | POSITIONS | SIDES[MOTOR] | SIDES[LINK] | IGNORED
    words: list[str] = []
    for part in re.split(r"[^A-Za-z0-9]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)):
        numbered = re.fullmatch(r"([a-z]+)(\d+)", part.lower())
        words += numbered.groups() if numbered and numbered[1] in symbols else [part.lower()] if part else []
    return words


def _unit_of(words: Sequence[str]) -> tuple[str, list[str]]:
    """Return the unit at the end of the words, "" if there is none, and the words before it."""
    units = {**UNIT, "m": "m", "n": "N"}
    for count in (2, 1):
        end = "".join(words[-count:])
        if len(words) > count and (count == 1 or words[-2:] == ["n", "m"]) and end in units:
            return units[end], list(words[:-count])
    return "", list(words)


def _delimiter_and_names(table: Path) -> tuple[str, list[str]]:
    """Return delimiter and names of the columns; raises RecordError, MissingPackageError."""
    pa = arrow()
    try:
        if table.name.endswith(PARQUET):
            return ",", list(pa.parquet.read_schema(table).names)
        headers: Mapping[str, list[str]] = {mark: header_of(table, mark)[1] for mark in ",;\t"}
    except (OSError, EOFError, UnicodeDecodeError, pa.ArrowException, csv.Error) as error:
        text = " ".join(str(error).split())
        raise RecordError(f"{table} is not a table ({text}); expected CSV in UTF-8, or Parquet") from None
    delimiter = max(headers, key=lambda mark: len(headers[mark]))
    if len(headers[delimiter]) == 1:
        raise RecordError(f"{table} has one column; expected several, with commas, semicolons or tabs between them")
    return delimiter, headers[delimiter]


def _few(columns: Sequence[Meaning], most: int = 3) -> str:
    names = [meaning.column for meaning in columns]
    return ", ".join(names) if len(names) <= most else f"{names[0]} to {names[-1]}"
