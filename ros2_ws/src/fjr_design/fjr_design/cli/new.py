# SPDX-License-Identifier: Apache-2.0
"""`fjr new`: write a robot file and a scenario file from a URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fjr_core.errors import FjrError
from fjr_core.files.text_file import write_text
from fjr_design.scaffold.arm import Arm, arm_of, described
from fjr_design.scaffold.files import file_names, robot_text, scenario_text, summary
from fjr_design.scaffold.proposal import proposal_of
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.scenarios.library import ScenarioError, load


def new(urdf: Path, joints: Sequence[str], chain: int | None, output: Path, name: str | None, force: bool) -> Result:
    """Write both files; force: replace earlier ones. Raises FjrError, which names the URDF."""
    try:
        arm = arm_of(urdf, joints, chain)
        stem, robot_file, scenario_file = file_names(arm, name)
        files = [output / robot_file, output / scenario_file]
        there = [file for file in files if file.exists() and not force]
        if there:
            raise ScenarioError(f"{there[0]} exists; expected a new file, another --name or --output, or --force")
        proposal = proposal_of(arm.robot, arm.joints, arm.urdf.name)
    except FjrError as error:
        error.args = (f"{urdf.name}: {error}",)
        raise
    output.mkdir(parents=True, exist_ok=True)
    write_text(files[0], robot_text(arm, output))
    write_text(files[1], scenario_text(stem, robot_file, arm, proposal))
    load(str(files[1]))  # a file that cannot be read back must not look finished
    lines = [*_other_chains(arm, joints), *summary(arm, proposal, files)]
    return Result("\n".join(lines), _values(arm, files, proposal.gains.beta))


def _other_chains(arm: Arm, joints: Sequence[str]) -> list[str]:
    """Return the chains of the URDF if there was a choice and none was made."""
    if joints or len(arm.chains) < 2:
        return []
    return [
        "chains     (--chain N or --joints A,B,... takes others)",
        *(f"           {each}" for each in described(arm.chains)),
    ]


def _values(arm: Arm, files: Sequence[Path], beta: float) -> dict[str, object]:
    """Return the result as JSON values."""
    return {
        "joints": arm.joints,
        "locked": arm.locked,
        "notes": arm.notes,
        "chains": [each.joints for each in arm.chains],
        "guesses": arm.guesses,
        "source": arm.source or None,
        "beta_per_s": beta,
        "robot_file": files[0],
        "scenario_file": files[1],
    }
