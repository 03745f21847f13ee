# SPDX-License-Identifier: Apache-2.0
"""Parse a URDF into a checked tree of joints and links.

Only kinematics and inertia are read; visuals, collision shapes and extensions are ignored.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from graphlib import CycleError, TopologicalSorter
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from ..errors import RobotError
from ..files.text_file import LARGEST, is_xml, read_bytes
from ..numerics.checks import Array

MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
NO_LIMIT = (-np.inf, np.inf, np.inf, np.inf)
DEEPEST, MOST_JOINTS = 100, 500  # levels of elements; joints of any kind
SMALLEST_INERTIA = 1e-15  # kg m^2; below that a negative principal inertia is rounding
LARGEST_NUMBER = 1e30  # sums and squares of larger numbers may overflow


@dataclass(frozen=True)
class UrdfJoint:
    """A URDF joint: axis in the joint frame, limits (lower, upper, velocity, effort), infinite without a limit.

    xyz [m], rpy [rad]: pose of the joint frame in that of the parent link. mimics: (joint, multiplier, offset) of
    <mimic>, or None.
    """

    name: str
    kind: str
    parent: str
    child: str
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]
    limits: tuple[float, ...]
    mimics: tuple[str, float, float] | None

    def pose(self, position: float = 0.0) -> Array:
        """Return the pose (4, 4) of the child link in the frame of the parent link at a position [rad, m]."""
        axis, motion = np.array(self.axis), np.eye(4)
        axis /= np.linalg.norm(axis) or 1.0  # that of a fixed joint may be 0
        if self.kind == "prismatic":
            motion[:3, 3] = position * axis
        else:
            motion[:3, :3] = _turn(axis, position)
        return _pose(self.xyz, self.rpy) @ motion


@dataclass(frozen=True, eq=False)
class LinkInertia:
    """Mass [kg], centre of mass com (3,) [m] and inertia (3, 3) [kg m^2] about it, in one frame."""

    mass: float
    com: Array
    inertia: Array

    def moved(self, pose: Array) -> LinkInertia:
        """Return the same inertia in the frame in which its own frame has this pose (4, 4)."""
        R = pose[:3, :3]
        return LinkInertia(self.mass, R @ self.com + pose[:3, 3], R @ self.inertia @ R.T)


@dataclass(frozen=True)
class UrdfTree:
    """All joints, and the inertias of all links that have one, by name.

    inertias: in the frame of the link. faulty: a sentence for each link whose inertia is invalid and left out.
    """

    joints: dict[str, UrdfJoint]
    inertias: dict[str, LinkInertia]
    faulty: dict[str, str]

    def joint(self, name: str) -> UrdfJoint:
        """Return the joint of this name; raise RobotError, with a suggestion, if there is none."""
        if name not in self.joints:
            close = get_close_matches(str(name), self.joints, n=1)
            hint = f"did you mean '{close[0]}'? " if close else ""
            moving = [joint.name for joint in self.joints.values() if joint.kind in MOVING]
            raise RobotError(f"the URDF has no joint '{name}'; {hint}expected some of {', '.join(moving)}")
        return self.joints[name]

    def position(self, joint: UrdfJoint, given: Mapping[str, float], named: Collection[str] = ()) -> float:
        """Return the position [rad, m] of a joint: that of the joint which it mimics, else the given one, else 0.

        Raises RobotError for a joint that mimics itself, one that is not there or one of the `named` joints.
        """
        scale, offset = 1.0, 0.0
        for _ in self.joints:
            if joint.mimics is None:
                return scale * given.get(joint.name, 0.0) + offset
            leader, multiplier, shift = joint.mimics
            scale, offset = scale * multiplier, scale * shift + offset
            if leader in named:
                raise RobotError(f"joint '{joint.name}' mimics the named joint '{leader}'; expected independence")
            joint = self.joint(leader)
        raise RobotError(f"joint '{joint.name}' mimics itself; expected another joint")

    def above(self, link: str) -> Iterator[UrdfJoint]:
        """Yield the joints from a link up to the root."""
        carriers = {joint.child: joint for joint in self.joints.values()}
        while link in carriers:
            yield carriers[link]
            link = carriers[link].parent

    def moved_by(self, names: Iterable[str]) -> set[str]:
        """Return the links that these joints move."""
        moved = {self.joints[name].child for name in names}
        while more := {joint.child for joint in self.joints.values() if joint.parent in moved} - moved:
            moved |= more
        return moved


def read_urdf(path_or_xml: str | os.PathLike[str]) -> UrdfTree:
    """Read a URDF file, or XML text that starts with '<'. Raises RobotError."""
    root = _root(path_or_xml)
    links = _by_name(root, "link")
    joints = {name: _joint(name, element) for name, element in _by_name(root, "joint").items()}
    _check_tree(list(links), joints)
    inertias: dict[str, LinkInertia] = {}
    faulty: dict[str, str] = {}
    for name, element in links.items():
        try:
            if (inertial := element.find("inertial")) is not None:
                inertias[name] = _inertia(f"link '{name}'", inertial)
        except RobotError as error:
            faulty[name] = str(error)
    return UrdfTree(joints, inertias, faulty)


def _root(path_or_xml: str | os.PathLike[str]) -> ET.Element:
    is_text = isinstance(path_or_xml, str) and is_xml(path_or_xml)
    source = "the URDF text" if is_text else f"URDF {os.fspath(path_or_xml)}"
    try:
        content = str(path_or_xml).lstrip("\ufeff").strip() if is_text else read_bytes(path_or_xml)
        root = parse_xml(content)
    except OSError as error:
        raise RobotError(f"{source} cannot be read ({error.strerror}); expected a file or XML text") from None
    except (ET.ParseError, expat.ExpatError, ValueError, LookupError) as error:
        raise RobotError(f"{source} does not parse as XML ({error}); expected a URDF") from None
    if root.tag != "robot":
        raise RobotError(f"{source} has the root element <{root.tag}>; expected the <robot> of a URDF")
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        makes = "by `xacro FILE > arm.urdf` of ROS 2, or by `xacrodoc FILE -o arm.urdf` of the package xacrodoc of PyPI"
        raise RobotError(f"{source} contains xacro commands; expected a plain URDF, {makes}")
    return root


def parse_xml(content: bytes | str) -> ET.Element:
    """Parse XML; prefixes need no declared namespace, as many URDFs have none for the extensions of a simulator.

    Raises ExpatError, and ValueError for XML that is too large, too deep or declares a document type (entities).
    """
    if len(content) > LARGEST:
        raise ValueError(f"larger than {LARGEST // 2**20} MiB")
    parser, tree, depth = expat.ParserCreate(), ET.TreeBuilder(), 0

    def declared(*_: object) -> NoReturn:
        raise ValueError("it declares a document type")

    def begun(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} levels deep")
        tree.start(tag, attributes)

    def ended(tag: str) -> None:
        nonlocal depth
        depth -= 1
        tree.end(tag)

    parser.StartDoctypeDeclHandler, parser.StartElementHandler, parser.EndElementHandler = declared, begun, ended
    parser.Parse(content, True)
    return tree.close()


def _by_name(root: ET.Element, tag: str) -> dict[str, ET.Element]:
    found: dict[str, ET.Element] = {}
    for element in root.findall(tag):
        name = element.get("name")
        if not name or name in found:
            raise RobotError(f"the URDF has a {tag} named {name!r} twice or without a name; expected one of each name")
        if not name.isprintable():
            raise RobotError(f"the URDF has a {tag} named {name!r}; expected names of printable characters")
        found[name] = element
    if not found:
        raise RobotError(f"the URDF has no <{tag}>; expected links and the joints between them")
    return found


def _joint(name: str, element: ET.Element) -> UrdfJoint:
    kind, where = element.get("type", ""), f"joint '{name}'"
    if kind not in KINDS:
        raise RobotError(f"{where} has the type {kind!r}; expected one of {', '.join(KINDS)}")
    axis = _numbers(where, element, "axis", "xyz", "1 0 0", 3)
    if kind in MOVING and not np.linalg.norm(axis) > 0:
        raise RobotError(f"{where} has the axis 0 0 0; expected a direction")
    parent, child = (_attribute(where, element, tag, "link") for tag in ("parent", "child"))
    limits = _limits(where, kind, element)
    mimics: tuple[str, float, float] | None = None
    if element.find("mimic") is not None:
        multiplier = _number(where, element, "mimic", "multiplier", "1")
        offset = _number(where, element, "mimic", "offset", "0")
        mimics = _attribute(where, element, "mimic", "joint"), multiplier, offset
    return UrdfJoint(name, kind, parent, child, *_origin(where, element), axis, limits, mimics)


def _limits(where: str, kind: str, element: ET.Element) -> tuple[float, ...]:
    """Return (lower, upper, velocity, effort); zero or missing values mean no limit."""
    names = ("lower", "upper", "velocity", "effort")
    lower, upper, velocity, effort = (_number(where, element, "limit", name, "0") for name in names)
    if velocity < 0 or effort < 0 or lower > upper:
        seen = f"lower={lower:g} upper={upper:g} velocity={velocity:g} effort={effort:g}"
        raise RobotError(f"{where} has <limit> {seen}; expected lower <= upper, velocity and effort 0 or more")
    if kind == "continuous" or lower == upper == 0:
        lower, upper = NO_LIMIT[:2]
    return lower, upper, velocity or np.inf, effort or np.inf


def _check_tree(links: list[str], joints: dict[str, UrdfJoint]) -> None:
    """Raise RobotError unless the links form a tree: one root, every other link the child of one joint, no loop."""
    if len(joints) > MOST_JOINTS:
        raise RobotError(f"the URDF has {len(joints)} joints; expected at most {MOST_JOINTS}")
    carriers: dict[str, str] = {}
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in links:
                raise RobotError(f"joint '{joint.name}' names the link '{link}'; expected one of {', '.join(links)}")
        if joint.child in carriers:
            both = f"'{carriers[joint.child]}' and '{joint.name}'"
            raise RobotError(f"link '{joint.child}' is the child of joints {both} (a closed chain); expected a tree")
        carriers[joint.child] = joint.name
    roots = [link for link in links if link not in carriers]
    if len(roots) > 1:
        raise RobotError(f"links {', '.join(roots)} have no parent joint; expected a single root")
    try:
        TopologicalSorter({joint.child: [joint.parent] for joint in joints.values()}).prepare()
    except CycleError as error:
        raise RobotError(f"link '{error.args[1][0]}' is its own ancestor (a closed chain); expected a tree") from None
    for joint in joints.values():
        if joint.kind in ("floating", "planar"):
            raise RobotError(f"joint '{joint.name}' is {joint.kind}; expected an arm with a fixed base")


def _inertia(where: str, inertial: ET.Element) -> LinkInertia:
    mass = _number(where, inertial, "mass", "value", "")
    xx, xy, xz, yy, yz, zz = (_number(where, inertial, "inertia", name, "") for name in INERTIA)
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass < 0:
        raise RobotError(f"{where} has the mass {mass}; expected 0 or more")
    if mass == 0 and np.any(inertia):
        raise RobotError(f"{where} has the mass 0 and an inertia; expected a mass, or neither")
    smallest, _, largest = np.linalg.eigvalsh(inertia)
    if smallest < -max(1e-12 * abs(largest), SMALLEST_INERTIA):
        raise RobotError(f"{where} has the principal inertia {smallest:.3g}; expected 0 or more")
    return LinkInertia(mass, np.zeros(3), inertia).moved(_pose(*_origin(where, inertial)))


def _origin(where: str, element: ET.Element) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return xyz [m] and rpy [rad] of the <origin> in the element."""
    xyz, rpy = (_numbers(where, element, "origin", name, "0 0 0", 3) for name in ("xyz", "rpy"))
    return xyz, rpy


def _pose(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> Array:
    """Return the pose (4, 4) with R = R_z(yaw) R_y(pitch) R_x(roll)."""
    pose, (x, y, z), (roll, pitch, yaw) = np.eye(4), np.eye(3), rpy
    pose[:3, :3], pose[:3, 3] = _turn(z, yaw) @ _turn(y, pitch) @ _turn(x, roll), xyz
    return pose


def _turn(axis: Array, angle: float) -> Array:
    """Return the rotation R = cos(a) E + sin(a) [k]x + (1 - cos(a)) k k' about a unit axis k (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.cos(angle) * np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * np.outer(axis, axis)


def _number(where: str, element: ET.Element, tag: str, name: str, default: str) -> float:
    return _numbers(where, element, tag, name, default, 1)[0]


def _numbers(where: str, element: ET.Element, tag: str, name: str, default: str, count: int) -> tuple[float, ...]:
    """Return the numbers of <tag name="..."> in the element; they may be infinite in <limit> only, and never nan."""
    found = element.find(tag)
    text = default if found is None else found.get(name, default)
    try:
        values = tuple(_float(word) for word in text.split())
    except ValueError:
        values = ()
    allowed = np.all(np.abs(values) <= LARGEST_NUMBER) or (tag == "limit" and not np.any(np.isnan(values)))
    if len(values) != count or not allowed:
        numbers = "a number" if count == 1 else f"{count} numbers"
        seen = f'<{tag} {name}="{text}">' if text else f"no <{tag} {name}=...>"
        raise RobotError(f"{where} has {seen}; expected {numbers}")
    return values


def _float(word: str) -> float:
    """Read a number in the C locale; Python also accepts 1_000 and digits of other scripts."""
    if not word.isascii() or "_" in word:
        raise ValueError(word)
    return float(word)


def _attribute(where: str, element: ET.Element, tag: str, name: str) -> str:
    found = element.find(tag)
    value = None if found is None else found.get(name)
    if not value:
        raise RobotError(f'{where} has no <{tag} {name}="...">; expected one')
    return value
