# SPDX-License-Identifier: Apache-2.0
"""A scenario whose springs harden is checked and runs in lock-step; what needs straight springs refuses it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("no_kept_proof")]

HARD = ("two_link", "--set", "robot.cubic_stiffness:=[4.0e3, 2.5e3]")  # twice the torque at 0.1 rad

AT = {
    "link_position": [0.3, 0.0],
    "motor_position": [0.34, 0.01],
    "link_velocity": [1.0, 2.1],
    "motor_velocity": [1.0, 2.1],
}
NEAR = [part for name, value in AT.items() for part in ("--set", f"initial_{name}:={value}")]  # the reference's start


def checked(*arguments: str) -> dict[str, Any]:
    """Return the JSON values of a check, which the warnings follow."""
    values: dict[str, Any] = json.JSONDecoder().raw_decode(fjr_here("check", *arguments, "--json"))[0]
    return values


def test_check_has_the_rate_of_straight_springs_and_the_tangents_under_the_weight() -> None:
    hard, straight = (checked(*each) for each in (HARD, HARD[:1]))
    assert hard["beta_per_s"] == straight["beta_per_s"]
    assert hard["beta_is_proven"]
    assert hard["stable"]
    assert "stiffer at rest on the reference" in hard["rows"]["springs"]
    assert "springs" not in straight["rows"]
    assert hard["spectral_radius"] != straight["spectral_radius"]


def test_check_warns_of_a_start_from_which_the_sampled_loop_diverges() -> None:
    """The shipped start is 0.3 rad off; a start on the reference tracks."""
    far, near = (checked(*HARD, *more) for more in ((), NEAR))
    assert any("diverges as sampled from the start error [-0.3, 0] rad" in each for each in far["warnings"])
    assert "diverges as sampled" in far["rows"]["start error"]
    assert not any("diverges" in each for each in near["warnings"])
    assert near["rows"]["start error"].startswith("springs deflect up to")
    assert near["rows"]["start error"].endswith("with springs as stiff as there")


POINTS = ("robot.torsion_deflection:=[0.02, 0.02, 0.05, 0.05]", "robot.torsion_torque:=[0.9, 0.4, 2.8, 0.9]")
TABLE = ("two_link", *(part for each in POINTS for part in ("--set", each)))  # the second joint softens


@pytest.mark.parametrize("springs", [HARD, TABLE], ids=["cubic", "table"])
def test_a_run_keeps_the_certificate_and_no_wiring_fault_is_seen(tmp_path: Path, springs: tuple[str, ...]) -> None:
    said = fjr_here("run", *springs, *NEAR, "--lockstep", "--duration", "1.5", "--output", str(tmp_path))
    assert said.splitlines()[3].endswith("holding"), said


def test_check_says_which_springs_of_a_table_are_stiffer_and_which_softer() -> None:
    found = checked(*TABLE)
    assert found["stable"]
    softer, stiffer = (
        [float(each) for each in part.split("[")[1].split("]")[0].split(",")]
        for part in found["rows"]["springs"].split("% softer")
    )
    assert softer[1] > 1 > softer[0]
    assert stiffer[0] > 1 > stiffer[1]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("check", *HARD, "--set", "law.type:=lqr"),
            "'law.type' is 'lqr' with a robot.cubic_stiffness; expected 'v_dpbc'",
        ),
        (("check", *HARD, "--prove-error"), "expected straight springs for a proof of the sampled loop"),
        (
            ("check", *HARD, "--set", "measurement.motor:=torque", "--set", "measurement.velocity:=observer"),
            "'measurement.motor' is 'torque' with a robot.cubic_stiffness",
        ),
    ],
)
def test_what_needs_straight_springs_says_so(
    arguments: tuple[str, ...], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    said = fjr_here(*arguments, codes=set(Exit) - {Exit.DONE})
    assert sentence in said + capfd.readouterr().err
