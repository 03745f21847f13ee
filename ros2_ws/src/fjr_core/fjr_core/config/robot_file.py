# SPDX-License-Identifier: Apache-2.0
"""Robots as files: what `robot.file` and `robot.urdf` point to, found and merged without ROS."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from ..errors import ParameterError
from ..files.text_file import read_text
from . import ros_yaml

FILE, URDF = "robot.file", "robot.urdf"
_SCHEME = "package://"


def merged(given: Mapping[str, object], node: str, folder: Path) -> dict[str, object]:
    """The values given to a node, over those of the robot file that they name.

    Paths of files in the result are absolute: one in `given` is relative to `folder`, one in the robot file
    to that file. Raises ParameterError for a robot file that cannot be found or holds anything else than
    joints and robot.*.
    """
    values = absolute(given, folder)
    name = values.get(FILE)
    if not name or not isinstance(name, str):
        return values
    path = Path(name)
    try:
        own = _own_values(path, node)
    except ParameterError as error:
        raise ParameterError(f"parameter '{FILE}': {error}") from None
    return {**absolute(own, path.parent), **values}


def _own_values(path: Path, node: str) -> dict[str, object]:
    document = ros_yaml.read(path, "robot file")
    try:
        own = ros_yaml.values_for(node, document)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None
    for name in own:
        if name == FILE or not (name == "joints" or name.startswith("robot.")):
            raise ParameterError(f"{path} holds '{name}'; expected joints and robot.* only, no other file")
    return own


def inlined(values: Mapping[str, object]) -> dict[str, object]:
    """Merged values that need no other file: the URDF's text in place of its path."""
    alone = {name: value for name, value in values.items() if name != FILE}
    urdf = alone.get(URDF)
    if isinstance(urdf, str) and not is_xml(urdf):
        try:
            alone[URDF] = read_text(urdf)
        except (OSError, UnicodeDecodeError) as error:
            raise ParameterError(f"parameter '{URDF}': cannot read {urdf} ({error}); expected a URDF") from None
    return alone


def is_xml(urdf: str) -> bool:
    """Whether the value of robot.urdf is the text itself, not a path."""
    return urdf.lstrip("\ufeff \t\r\n").startswith("<")


def resolve(reference: str, folder: Path) -> Path:
    """The file that ``package://name/path``, an absolute path or one relative to `folder` means.

    Packages are looked for as ROS does, below share in the folders of AMENT_PREFIX_PATH; raises
    ParameterError when none has it.
    """
    if not reference.startswith(_SCHEME):
        return folder.absolute() / reference
    package, _, path = reference[len(_SCHEME) :].partition("/")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        share = Path(prefix, "share", package)
        if prefix and package and os.path.isdir(share):
            return share / path
    raise ParameterError(
        f"'{reference}' names package '{package}', which no folder of AMENT_PREFIX_PATH has; "
        "expected one that is built and sourced"
    )


def absolute(given: Mapping[str, object], folder: Path) -> dict[str, object]:
    """The given values with robot.file and robot.urdf as absolute paths; relative ones are relative to `folder`."""
    values = dict(given)
    for name in (FILE, URDF):
        reference = values.get(name)
        if isinstance(reference, str) and reference and not is_xml(reference):
            try:
                values[name] = str(resolve(reference, folder))
            except ParameterError as error:
                raise ParameterError(f"parameter '{name}': {error}") from None
    return values
