# SPDX-License-Identifier: Apache-2.0
"""Commands that write files: `fjr new` from a URDF or MJCF; a scenario as URDF, as C99, as MJCF and for ros2_control.

`fjr new` makes a robot file and a scenario; `fjr description`, `fjr export-c`, `fjr export-mjcf` and
`fjr export-ros2-control` read one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from xml.parsers.expat import ExpatError

import numpy as np

from fjr_core.config.robot import description
from fjr_core.config.scenario import left_out
from fjr_core.errors import FjrError
from fjr_core.files.importing import module
from fjr_core.files.text_file import read_bytes, write_text
from fjr_core.urdf.tree import parse_xml
from fjr_design.exports.c_code import prefix_of
from fjr_design.exports.project import export, write
from fjr_design.exports.ros2_control.package import export_package, not_exported, package_name_of
from fjr_design.scaffold.arm import Arm, arm_of, described
from fjr_design.scaffold.files import INERTIA, STIFFNESS, by_unit, locked_joints, origin_of, robot_text, scenario_text
from fjr_design.scaffold.first_loop import RATE, Proposal, proposal_of
from fjr_msgs_py.console.output import Result, plural
from fjr_msgs_py.scenarios import library
from fjr_msgs_py.scenarios.library import ScenarioError


def new(urdf: Path, joints: Sequence[str], chain: int | None, output: Path, name: str | None, force: bool) -> Result:
    """Write both files, and the URDF of an MJCF; force: replace earlier ones. Raises FjrError, which names the file."""
    given = name or urdf.stem
    stem = re.sub(r"\W+", "_", given, flags=re.ASCII).strip("_") or "arm"
    robot_file, scenario_file = output / f"{stem}_robot.yaml", output / f"{stem}.yaml"
    texts: dict[Path, str] = {}
    try:
        if _is_mjcf(urdf):
            own = output / f"{stem}.urdf"
            texts[own], known = module("fjr_engines.mjcf.reading").read_mjcf(urdf, output)
            arm = arm_of(own, joints, chain, texts[own], known)
        else:
            arm = arm_of(urdf, joints, chain)
        for file in (*texts, robot_file, scenario_file):
            if file.exists() and not force:
                raise ScenarioError(f"{file} exists; expected a new file, another --name or --output, or --force")
        proposal = proposal_of(arm.robot, arm.joints, urdf.name)
    except FjrError as error:
        error.args = (str(error) if str(urdf) in str(error) else f"{urdf.name}: {error}",)
        raise
    texts[robot_file] = robot_text(arm, output)
    texts[scenario_file] = scenario_text(stem, robot_file.name, arm, proposal)
    output.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        write_text(file, text)
    library.load(str(scenario_file))  # a file that cannot be read back must not look finished
    values = {
        "joints": arm.joints,
        "locked": arm.locked,
        "notes": arm.notes,
        "chains": arm.chains,
        "guesses": arm.guesses,
        "source": arm.source or None,
        "beta_per_s": proposal.gains.beta,
        "robot_file": robot_file,
        "scenario_file": scenario_file,
    }
    lines = _summary(arm, proposal, had_a_choice=not joints and len(arm.chains) > 1)
    lines += [
        *([f"name       {stem}, for '{given}': letters of ASCII, digits and _"] if stem != given else []),
        f"written    {', '.join(map(str, texts))}",
        f"next       fjr check {quote(str(scenario_file))}",
        f"           fjr run {quote(str(scenario_file))} --lockstep",
    ]
    return Result("\n".join(lines), values)


def _is_mjcf(file: Path) -> bool:
    """Return whether a file has the root element of an MJCF; what no XML parser reads is none."""
    try:
        return bool(parse_xml(read_bytes(file)).tag == "mujoco")
    except (OSError, ValueError, LookupError, ExpatError):
        return False


def _summary(arm: Arm, proposal: Proposal, had_a_choice: bool) -> list[str]:
    """Return what was chosen, a line for each subject; had_a_choice: list the chains of the URDF first."""
    gains, amplitudes = proposal.gains, by_unit(arm, "rad", np.asarray(proposal.motion.amplitude))
    reach = " and ".join(f"{max(values):.2g} {unit}" for unit, values in amplitudes.items())
    stiffness, inertia = (
        " and ".join(f"{min(values):g} to {max(values):g} {each}" for each, values in by_unit(arm, *of).items())
        for of in ((STIFFNESS, np.diag(arm.robot.K)), (INERTIA, np.diag(arm.robot.M_m)))
    )
    chains = [f"           {each}" for each in described(arm.chains)]
    return [
        *(["chains     (--chain N or --joints A,B,... takes others)", *chains] if had_a_choice else []),
        f"joints     {', '.join(arm.joints)}",
        *([f"locked     {locked_joints(arm.locked)}"] if arm.locked else []),
        *(f"note       {note}" for note in arm.notes),
        f"stiffness  {stiffness}{origin_of(arm, 'joint_stiffness')}",
        f"inertia    {inertia} of the motors{origin_of(arm, 'motor_inertia')}",
        f"gains      beta {gains.beta:g} 1/s {gains.where}; delay margin {gains.check.delay_margin:.2f} samples at "
        f"{RATE:g} Hz in the whole range",
        f"motion     {reach} at most, at 0.5 Hz",
    ]


def describe(scenario: str | None, assignments: Sequence[str]) -> Result:
    """Return the robot of a scenario as URDF."""
    urdf = description(library.load(scenario, assignments, robot_only=True).plant_values)
    return Result(urdf.removesuffix("\n"), {"urdf": urdf})


def export_scenario(scenario: str, assignments: Sequence[str], folder: Path, prefix: str | None, force: bool) -> Result:
    """Write control step and plant of a scenario as C99; force: replace an earlier export. Raises FjrError."""
    loaded = library.load(scenario, assignments)
    missing = [name for name in left_out(loaded) if name in loaded.plant_values]
    names = ", ".join(f"`{name}`" for name in missing)
    notes = f"\nThe scenario also sets {names}: not in this C.\n" if missing else ""
    texts, shown = export(loaded, prefix or prefix_of(loaded.name), notes=notes), quote(str(folder))
    write(texts, folder, force)
    text = (
        f"{folder}: {', '.join(texts)}\n"
        f"build and compare with Python: cmake -S {shown} -B {shown}/build && cmake --build {shown}/build && "
        f"ctest --test-dir {shown}/build --verbose"
    )
    if missing:
        text += f"\nnot exported: what {', '.join(missing)} add to the plant"
    return Result(text, {"folder": folder, "files": list(texts), "not_exported": list(missing)})


def export_mjcf(scenario: str, assignments: Sequence[str], file: Path, force: bool) -> Result:
    """Write a robot for MuJoCo, with its meshes beside the file; force: replace earlier ones. Raises FjrError."""
    contents, notes = module("fjr_engines.mjcf.export").mjcf(library.load(scenario, assignments), file.name)
    write(contents, file.parent, force, beside=True)
    lines = [
        f"{file}: {plural(len(contents) - 1, 'mesh', 'meshes')} beside it",
        *(f"note  {note}" for note in notes),
        f"view  python -m mujoco.viewer --mjcf={file}",
        "ros2  mujoco_ros2_control: command interface <joint>_motor/effort, states of <joint> and <joint>_motor",
        f"back  fjr new {file}",
    ]
    files = [file.parent / name for name in contents]
    return Result("\n".join(lines), {"file": file, "files": files, "notes": notes})


def export_ros2_control(
    scenario: str, assignments: Sequence[str], folder: Path, package: str | None, force: bool
) -> Result:
    """Write a package for ros2_control; force: replace an earlier export. Raises FjrError."""
    loaded = library.load(scenario, assignments)
    name = package or package_name_of(loaded.name)
    texts = export_package(loaded, name)
    write(texts, folder, force)
    missing = not_exported(loaded)
    text = (
        f"{folder}: package {name}, {len(texts)} files\n"
        f"build and test it where ros2_control is installed: colcon build --base-paths {folder} && "
        f"colcon test --base-paths {folder}"
    )
    if missing:
        text += f"\nnot exported: {', '.join(missing)} of the simulated robot"
    return Result(text, {"folder": folder, "package": name, "files": list(texts), "not_exported": missing})
