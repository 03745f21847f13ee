# SPDX-License-Identifier: Apache-2.0
"""Files that values name: resolve and merge those of `robot.file` and `robot.urdf`, and inline them, without ROS.

The motion of `reference.file.path` is resolved and inlined here, too.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from ..errors import ParameterError, TrajectoryError, prefixed
from ..files.text_file import is_lines, is_xml, read_text
from . import ros_yaml

FILE, URDF, MOTION, OBSTACLE = "robot.file", "robot.urdf", "reference.file.path", "obstacle.mjcf"
_SCHEME = "package://"


def merged(given: Mapping[str, object], node: str, folder: Path) -> dict[str, object]:
    """Return the values given to a node merged with its robot file; given values override the file.

    Paths in the result are absolute. A path in `given` is relative to `folder`, a path in the robot file to that
    file. Raises ParameterError if the robot file cannot be found or gives all nodes anything but joints, robot.* and
    imperfections.*. What it gives to a single node beside these is ignored: it makes the file a scenario, too.
    """
    values = absolute(given, folder)
    name = values.get(FILE)
    if not name or not isinstance(name, str):
        return values
    path = Path(name)
    with prefixed(f"parameter '{FILE}': "):
        own = _own_values(path, node)
    return {**absolute(own, path.parent), **values}


def _own_values(path: Path, node: str) -> dict[str, object]:
    document = ros_yaml.read(path, "robot file")
    with prefixed(f"{path}: "):
        own = ros_yaml.values_for(node, document)
    shared = ros_yaml.values_for(ros_yaml.SHARED, document)
    for name in own:
        if name == FILE or (name in shared and not is_of_robot(name)):
            raise ParameterError(
                f"{path} holds '{name}'; expected joints, robot.* and imperfections.* only, no other file"
            )
    return {name: value for name, value in own.items() if is_of_robot(name)}


def is_of_robot(name: str) -> bool:
    """Return whether a robot file may hold a parameter of this name."""
    return name == "joints" or name.startswith(("robot.", "imperfections."))


def inlined(values: Mapping[str, object]) -> dict[str, object]:
    """Return merged values that need no other file: the URDF's text, with absolute mesh paths, replaces its path."""
    alone = {name: value for name, value in values.items() if name != FILE}
    urdf = alone.get(URDF)
    if isinstance(urdf, str) and not is_xml(urdf):
        try:
            alone[URDF] = located(read_text(urdf), Path(urdf).parent)
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", error)
            raise ParameterError(f"parameter '{URDF}': cannot read {urdf} ({reason}); expected a URDF") from None
    return alone


def motion_inlined(values: Mapping[str, object], joints: tuple[str, ...]) -> dict[str, object]:
    """Return the values with the text of the motion in place of its path; raise ParameterError."""
    from ..files.motion_table import motion_text, read_motion

    path = values.get(MOTION)
    if not isinstance(path, str) or not path or is_lines(path):
        return dict(values)
    with prefixed(f"parameter '{MOTION}': ", TrajectoryError):
        return {**values, MOTION: motion_text(read_motion(path, joints), joints)}


def resolve(reference: str, folder: Path) -> Path:
    """Return the file of ``package://name/path``, of an absolute path or of a path relative to `folder`.

    Packages are searched below share in the folders of AMENT_PREFIX_PATH, as in ROS. Raises ParameterError if
    none of them has the package.
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
        "expected a package that is built and sourced"
    )


def absolute(given: Mapping[str, object], folder: Path) -> dict[str, object]:
    """Return the values with the paths of files as absolute paths; relative paths start at `folder`."""
    values = dict(given)
    for name in (FILE, URDF, MOTION, OBSTACLE):
        reference = values.get(name)
        if isinstance(reference, str) and reference and not is_xml(reference) and not is_lines(reference):
            with prefixed(f"parameter '{name}': "):
                values[name] = str(resolve(reference, folder))
    return values


_FILE_NAME = re.compile(r"(<mesh\b[^>]*?\bfilename\s*=\s*)([\"'])(.*?)\2", re.DOTALL)
_URI = "file://"


def located(urdf: str, folder: Path) -> str:
    """Return the URDF text with file:// paths of the meshes that exist in `folder`, where its file is, or above it.

    A relative path starts at the folder. ``package://name/path`` is replaced if the folder or one above it is called
    `name`, or contains a folder of that name, and has the path in it. All other text stays as it is.
    """

    def replaced(match: re.Match[str]) -> str:
        path = next((path for path in _candidates(match[3], folder.absolute()) if path.is_file()), None)
        return match[0] if path is None else f"{match[1]}{match[2]}{_URI}{path}{match[2]}"

    return _FILE_NAME.sub(replaced, urdf)


def _candidates(name: str, folder: Path) -> Iterator[Path]:
    if not name.startswith(_SCHEME):
        if not name.startswith(_URI) and not Path(name).is_absolute():
            yield folder / name
        return
    package, _, path = name[len(_SCHEME) :].partition("/")
    for above in (folder, *folder.parents):
        if above.name == package:
            yield above / path
        yield above / package / path
