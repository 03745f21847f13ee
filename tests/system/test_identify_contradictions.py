# SPDX-License-Identifier: Apache-2.0
"""Tables with mistakes end in one sentence of `fjr identify` that names signal and joint; nothing is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from system.motion_tables import MotionTable, one_joint, two_joints

pytestmark = pytest.mark.system
BOTH, MOTOR, SENSOR, LINK = ("link", "motor"), ("motor",), ("motor", "torque"), ("link", "torque")
Change = Callable[[MotionTable], MotionTable]


def elbow(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Return a change of one signal of the elbow."""
    return lambda table: table.with_joint(name, 1, change(table.signals[name][:, 1]))


def exchanged(*names: str) -> Change:
    """Return a change that exchanges the joints of some signals."""
    return lambda table: replace(
        table, signals={name: x[:, ::-1] if name in names else x for name, x in table.signals.items()}
    )


def swapped(table: MotionTable) -> MotionTable:
    """Return the table with the sides of the elbow swapped."""
    link, motor = (table.signals[name][:, 1] for name in BOTH)
    return table.with_joint("link", 1, motor).with_joint("motor", 1, link)


def stopped(x: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(x)) < 700, x, x[700])


def late(x: np.ndarray) -> np.ndarray:
    return np.concatenate([np.full(10, x[0]), x[:-10]])


def spiked(x: np.ndarray) -> np.ndarray:
    return x + 0.5 * (np.arange(len(x)) == 600)


def missing(x: np.ndarray) -> np.ndarray:
    return np.where(np.abs(np.arange(len(x)) - 600) < 5, np.nan, x)


ONE_FAULT: Mapping[str, tuple[tuple[str, ...], Change, str]] = {
    "sides of one joint": (BOTH, swapped, "elbow"),
    "sign of one effort": (BOTH, elbow("effort", np.negative), "effort of elbow is -"),
    "sign of one motor": (BOTH, elbow("motor", np.negative), "q_m of elbow moves against q_l"),
    "sign of one motor alone": (MOTOR, elbow("motor", np.negative), "elbow"),
    "sign of one torque sensor": (SENSOR, elbow("torque", np.negative), "torque of elbow is -"),
    "one gear ratio applied twice": (BOTH, elbow("motor", lambda x: x / 100), "q_m of elbow moves 0.0"),
    "one gear ratio not applied": (BOTH, elbow("motor", lambda x: 100 * x), "q_m of elbow moves 99"),
    "one ratio of 101 in place of 100": (BOTH, elbow("motor", lambda x: 1.01 * x), "q_m of elbow moves 1.01"),
    "one effort at the motor's shaft": (BOTH, elbow("effort", lambda x: x / 100), "effort of elbow is 0.0"),
    "efforts in mN m": (MOTOR, lambda t: t.with_signal("effort", 1e3 * t.signals["effort"]), "effort of shoulder is 1"),
    "one link in degrees": (BOTH, elbow("link", np.degrees), "degrees against rad"),
    "motors alone in degrees": (MOTOR, lambda t: t.with_signal("motor", np.degrees(t.signals["motor"])), "degrees"),
    "one effort clipped": (BOTH, elbow("effort", lambda x: np.minimum(x, 0.6 * x.max())), "effort of elbow is"),
    "a motor that stops": (MOTOR, elbow("motor", stopped), "q_m of elbow stops at"),
    "a revolution lost": (BOTH, elbow("link", lambda x: x - 2 * np.pi * (np.arange(len(x)) > 600)), "jumps by -6.28"),
    "a spike": (MOTOR, elbow("motor", spiked), "q_m of elbow jumps by 0.5"),
    "a gap of NaN": (BOTH, elbow("link", missing), "column link_elbow: nan; expected a finite number (9 such rows"),
    "a link 40 ms late": (BOTH, elbow("link", late), "q_l of elbow is read 38."),
    "one column for both sides": (
        BOTH,
        lambda table: table.with_signal("link", table.signals["motor"]),
        "q_m - q_l of shoulder is constant at every sample",
    ),
    "joints of the efforts exchanged": (MOTOR, exchanged("effort"), "the efforts of shoulder and elbow fit the motion"),
    "joints of the links exchanged": (BOTH, exchanged("link"), "q_m of shoulder follows q_l of elbow"),
    "all joints exchanged": (BOTH, exchanged("effort", *BOTH), "all signals of shoulder and elbow fit the robot in"),
    "joints of the motors exchanged": (SENSOR, exchanged("motor"), "the positions of shoulder and elbow fit the robot"),
    "half a gear ratio, motors alone": (
        MOTOR,
        elbow("motor", lambda x: 2 * x),
        "motion of elbow fit the links of the robot only with positions 0.5 times as large",
    ),
    "gear ratio of position and effort, motors alone": (
        MOTOR,
        lambda t: elbow("effort", lambda x: 2 * x)(elbow("motor", lambda x: x / 2)(t)),
        "only with positions 2 times and efforts 0.5 times as large",
    ),
    "a time of half the length, motors alone": (MOTOR, lambda t: replace(t, t=t.t / 2), "with a time 2 times as long"),
    "a time of twice the length, links": (LINK, lambda t: replace(t, t=2 * t.t), "with a time 0.5 times as long"),
    "every tenth row lost": (BOTH, lambda t: t.rows([k for k in range(1000) if k % 10]), "of the steps are longer"),
}


@pytest.mark.parametrize("label", ONE_FAULT)
def test_a_mistake_in_one_joint_of_two_is_named(tmp_path: Path, label: str) -> None:
    measured, change, sentence = ONE_FAULT[label]
    said = change(two_joints().of(*measured)).refused(tmp_path)
    assert sentence in said, said


TWO_FAULTS: Mapping[str, tuple[Change, tuple[str, ...]]] = {
    "sides swapped and sign of the other effort": (
        lambda t: swapped(t).with_joint("effort", 0, -t.signals["effort"][:, 0]),
        ("swapped_sides", "sign"),
    ),
    "degrees and a wrong gear ratio": (
        lambda t: t.with_signal("link", np.degrees(t.signals["link"])).with_joint(
            "motor", 0, 50 * t.signals["motor"][:, 0]
        ),
        ("degrees", "gear_ratio"),
    ),
    "a spike and a clipped effort": (
        lambda t: elbow("link", spiked)(t).with_joint("effort", 0, np.minimum(t.signals["effort"][:, 0], 5.0)),
        ("jump", "clipped"),
    ),
}


@pytest.mark.parametrize("label", TWO_FAULTS)
def test_accepting_one_of_two_mistakes_shows_the_other(tmp_path: Path, label: str) -> None:
    change, kinds = TWO_FAULTS[label]
    table, accepted, seen = change(two_joints().of(*BOTH)), [], set()
    for _ in kinds:
        said = table.refused(tmp_path, *accepted)
        kind = said.partition("--accept ")[2].split()[0]
        seen.add(kind)
        accepted += ["--accept", kind]
    assert seen & set(kinds), seen
    assert len(seen) == len(kinds)


def test_units_of_the_time_are_checked_against_the_period(tmp_path: Path) -> None:
    said = one_joint().of(*BOTH).refused(tmp_path, time="time: {column: t, unit: ms}")
    assert "samples are 4e-06 s apart" in said


def test_mistakes_of_a_mapping_file_are_found(tmp_path: Path) -> None:
    table, entry = two_joints().of(*BOTH), "{column: '%s_{joint}', unit: %s}"
    inverse = "motor_position: {column: 'motor_{joint}', unit: rad, gear_ratio: [1, 0.01]}"
    assert "q_m of elbow moves 99" in table.refused(tmp_path, motor=inverse)
    exchanged_columns = "effort: {column: [u_elbow, u_shoulder], unit: N m}"
    assert "the efforts of shoulder and elbow fit" in table.refused(tmp_path, effort=exchanged_columns)
    assert "degrees" in table.refused(tmp_path, link="link_position: " + entry % ("link", "deg"))
