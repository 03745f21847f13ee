# SPDX-License-Identifier: Apache-2.0
"""`fjr new`: write a robot file and a scenario file from a URDF."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fjr_core.errors import FjrError
from fjr_core.files.atomic_file import write_text
from fjr_design.scaffold.arm import Arm, arm_of, described
from fjr_design.scaffold.files import locked_joints, origin_of, robot_text, scenario_text
from fjr_design.scaffold.first_loop import RATE, Proposal, proposal_of
from fjr_msgs_py.console.result import Result
from fjr_msgs_py.scenarios.library import ScenarioError, load


def new(urdf: Path, joints: Sequence[str], chain: int | None, output: Path, name: str | None, force: bool) -> Result:
    """Write both files; force: replace earlier ones. Raises FjrError, which names the URDF."""
    try:
        arm = arm_of(urdf, joints, chain)
        stem = re.sub(r"\W+", "_", name or urdf.stem, flags=re.ASCII).strip("_") or "arm"
        robot_file, scenario_file = output / f"{stem}_robot.yaml", output / f"{stem}.yaml"
        for file in (robot_file, scenario_file):
            if file.exists() and not force:
                raise ScenarioError(f"{file} exists; expected a new file, another --name or --output, or --force")
        proposal = proposal_of(arm.robot, arm.joints, urdf.name)
    except FjrError as error:
        error.args = (f"{urdf.name}: {error}",)
        raise
    output.mkdir(parents=True, exist_ok=True)
    write_text(robot_file, robot_text(arm, output))
    write_text(scenario_file, scenario_text(stem, robot_file.name, arm, proposal))
    load(str(scenario_file))  # a file that cannot be read back must not look finished
    values = {
        "joints": arm.joints,
        "locked": arm.locked,
        "notes": arm.notes,
        "chains": [each.joints for each in arm.chains],
        "guesses": arm.guesses,
        "source": arm.source or None,
        "beta_per_s": proposal.gains.beta,
        "robot_file": robot_file,
        "scenario_file": scenario_file,
    }
    lines = _summary(arm, proposal, had_a_choice=not joints and len(arm.chains) > 1)
    lines += [
        f"written    {robot_file}, {scenario_file}",
        f"next       fjr check {scenario_file}",
        f"           fjr run {scenario_file} --lockstep",
    ]
    return Result("\n".join(lines), values)


def _summary(arm: Arm, proposal: Proposal, had_a_choice: bool) -> list[str]:
    """Return what was chosen, a line for each subject; had_a_choice: list the chains of the URDF first."""
    gains, K, M_m = proposal.gains, np.diag(arm.robot.K), np.diag(arm.robot.M_m)
    largest: dict[str, float] = {}  # amplitude of the revolute joints [rad] and of the prismatic joints [m]
    for value, unit in zip(np.asarray(proposal.motion.amplitude), arm.robot.units, strict=True):
        largest[unit.position] = max(float(value), largest.get(unit.position, 0.0))
    reach = " and ".join(f"{value:.2g} {unit}" for unit, value in largest.items())
    chains = [f"           {each}" for each in described(arm.chains)]
    return [
        *(["chains     (--chain N or --joints A,B,... takes others)", *chains] if had_a_choice else []),
        f"joints     {', '.join(arm.joints)}",
        *([f"locked     {locked_joints(arm.locked)}"] if arm.locked else []),
        *(f"note       {note}" for note in arm.notes),
        f"stiffness  {K.min():g} to {K.max():g} N m/rad{origin_of(arm, 'joint_stiffness')}",
        f"inertia    {M_m.min():g} to {M_m.max():g} kg m^2 of the motors{origin_of(arm, 'motor_inertia')}",
        f"gains      beta {gains.beta:g} 1/s {gains.where}; delay margin {gains.check.delay_margin:.2f} samples at "
        f"{RATE:g} Hz in the whole range",
        f"motion     {reach} at most, at 0.5 Hz",
    ]
