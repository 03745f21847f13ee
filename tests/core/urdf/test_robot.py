# SPDX-License-Identifier: Apache-2.0
"""robot_from_urdf and its recursions agree with Pinocchio's model of the same text; limits, elastic data, refusals."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from tools.robot_survey import ROBOTS

import fjr_core as fjr
from core.oracles.cases import Array
from core.oracles.chains import ARM7, ARM7_JOINTS, PinocchioLinks, random_urdf
from fjr_core.urdf.robot import reduced_bodies
from fjr_core.urdf.tree import MOVING, read_urdf
from fjr_design.scaffold.arm import chains

CASES = [(n, seed) for n in (1, 2, 3, 5, 7) for seed in range(3)]
all_cases = pytest.mark.parametrize("case", [pytest.param(c, id=f"{c[0]}-joints-{c[1]}") for c in CASES])


def relative(left: Array, right: Array) -> float:
    return float(np.max(np.abs(left - right)) / max(np.max(np.abs(right)), 1e-3))


def robot_of(case: tuple[int, int]) -> tuple[fjr.Robot, PinocchioLinks]:
    urdf = random_urdf(*case)
    robot = fjr.robot_from_urdf(urdf.xml, urdf.joints, 100.0, 0.1, gravity=urdf.gravity, locked=urdf.locked)
    return robot, urdf.pinocchio


def agreement(robot: fjr.Robot, oracle: PinocchioLinks, seed: int) -> float:
    """Return the largest relative difference of M, C w, M a + C w, E, gradients and potential differences."""
    q, other, v, w, a = np.random.default_rng(seed).uniform(-2, 2, (5, robot.n))
    M, C, links, symbols = oracle.M(q), oracle.C(q, v), robot.links, [ca.SX.sym(name, robot.n) for name in "qvw"]
    workless = ca.Function("E", symbols, [links.E(*symbols)])
    drop = np.array([robot.P_l(q) - robot.P_l(other)]), np.array([oracle.P(q) - oracle.P(other)])
    return max(
        relative(robot.M_l(q), M),
        relative(robot.coriolis(q, v, w), C @ w),
        relative(links.inertial_torque(q, v, w, a).full().ravel(), M @ a + C @ w),
        relative(robot.grad_P_l(q), oracle.grad_P(q)),
        relative(links.grad_T(q, v).full().ravel(), C.T @ v),
        relative(workless(q, v, w).full().ravel(), -C.T @ w),
        relative(*drop),
    )


@all_cases
def test_named_joints_in_any_order_with_others_locked_agree_with_pinocchio(case: tuple[int, int]) -> None:
    """Inertia, Coriolis product, inertial torque, workless forces, gravity, potential and kinetic gradient."""
    robot, oracle = robot_of(case)
    assert agreement(robot, oracle, seed=case[1]) < 1e-10
    M = robot.M_l(np.ones(robot.n))
    assert np.array_equal(M, M.T)


def test_path_and_text_give_the_same_robot_with_a_byte_order_mark_extensions_or_links_named_as_joints(
    tmp_path: Path,
) -> None:
    text, file, q = ARM7.read_text(encoding="utf-8"), tmp_path / "arm.urdf", np.linspace(-1, 1, 7)
    marked = f"\ufeff{text}"
    extended = text.replace("</robot>", "<gazebo><sim:sensor sim:rate='1'/></gazebo></robot>")
    same_names = re.sub(r'"link(\d)"', r'"joint\1"', text)
    file.write_text(marked, encoding="utf-8")
    assert len({text, marked, extended, same_names}) == 4
    sources = (file, str(file), marked, text, extended, same_names)
    robots = [fjr.robot_from_urdf(source, ARM7_JOINTS, 100.0, 0.1) for source in sources]
    assert all(np.array_equal(robot.M_l(q), robots[0].M_l(q)) for robot in robots)


# The bodies alone.

KR300 = Path(__file__).parents[3] / "examples/kr300/kr300.urdf"
URDFS = {
    **{f"random {n} {seed}": random_urdf(n, seed).xml for n in (1, 2, 3, 5, 7) for seed in range(3)},
    **{robot.name: robot.urdf for robot in ROBOTS if robot.package in ("airo-models", "rtb-data")},
    **{path.stem: path for path in (ARM7, KR300)},
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", URDFS)
def test_bodies_equal_those_of_the_reduced_model_of_pinocchio(name: str, seed: int) -> None:
    """All joints of the longest chain are named, then some, with the others locked at random."""
    source, rng = URDFS[name], np.random.default_rng(seed)
    tree = read_urdf(source)
    chain = chains(tree)[0]
    joints = [joint for joint in chain if seed == 0 or rng.random() < 0.6] or [chain[-1]]
    moving = [joint.name for joint in tree.joints.values() if joint.kind in MOVING and joint.name not in joints]
    locked = dict(zip(moving, rng.uniform(-2, 2, len(moving)), strict=True))
    model = pin.buildModelFromXML(source.read_text(encoding="utf-8") if isinstance(source, Path) else source)
    rest = PinocchioLinks(model, [], locked).rest
    reduced = pin.buildReducedModel(model, [model.getJointId(joint) for joint in locked], rest)

    bodies = reduced_bodies(tree, joints, locked)
    assert list(bodies) == list(reduced.names)[1:]
    for body, placement, expected in zip(
        bodies.values(), list(reduced.jointPlacements)[1:], list(reduced.inertias)[1:], strict=True
    ):
        pairs = [
            (body.rotation, placement.rotation),
            (body.translation, placement.translation),
            (body.mass, expected.mass),
            (body.com, expected.lever if expected.mass else np.zeros(3)),
            (body.inertia, expected.inertia),
        ]
        for found, oracle in pairs:
            np.testing.assert_allclose(found, oracle, rtol=1e-12, atol=1e-12)


# A hand-written planar arm, which the tests below modify.

ZERO = 'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"'


def link(name: str, mass: float = 1.0, com: float = 0.1, inertia: str = ZERO.replace('iyy="0"', 'iyy="0.01"')) -> str:
    inner = f'<origin xyz="0 0 {-com}"/><mass value="{mass}"/><inertia {inertia}/>'
    return f'<link name="{name}"><inertial>{inner}</inertial></link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inner: str = "", z: float = 0.0) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 {z}"/><axis xyz="0 1 0"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inner}</joint>'


def robot(*parts: str) -> str:
    return f'<robot name="r">{"".join(parts)}</robot>'


BASE = '<link name="base"/>'
SHOULDER, ELBOW = joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower", z=-0.3)
TWO = robot(BASE, link("upper"), link("lower"), SHOULDER, ELBOW)


def with_more(*parts: str, xml: str = TWO) -> str:
    """Return the URDF with further links and joints."""
    return xml.replace("</robot>", "".join(parts) + "</robot>")


def limited(limit: str, kind: str = "revolute") -> str:
    """Return an arm with one joint and a tag <limit>."""
    return robot(BASE, link("upper"), joint("shoulder", "base", "upper", kind, limit))


def read(xml: str, joints: Any = ("shoulder", "elbow"), stiffness: Any = 50.0, **values: Any) -> fjr.Robot:
    return fjr.robot_from_urdf(xml, joints, stiffness, values.pop("motor_inertia", 0.1), **values)


# Elastic data.


def test_elastic_data_have_the_named_order() -> None:
    K, M_m = np.array([[50.0, 4.0], [4.0, 30.0]]), np.array([[0.2, 0.03], [0.03, 0.1]])
    arm = read(
        TWO, ["elbow", "shoulder"], K, motor_inertia=M_m, link_damping=(1, 2), motor_damping=3, input_gain=(2, 4)
    )
    wanted = {"K": K, "M_m": M_m, "D_l": np.diag([1, 2]), "D_m": np.diag([3, 3]), "B_m": np.diag([2, 4])}
    for name, matrix in wanted.items():
        np.testing.assert_array_equal(getattr(arm, name), matrix)
    assert np.allclose(arm.M_l([0, 0]), read(TWO).M_l([0, 0])[::-1, ::-1], rtol=1e-15)


def test_a_gear_ratio_reflects_the_rotors_inertia() -> None:
    rotor = np.array([[2e-5, 1e-6], [1e-6, 1e-5]])
    arm = read(TWO, motor_inertia=rotor, gear_ratio=(100, -50))
    assert np.allclose(arm.M_m, [[0.2, -0.005], [-0.005, 0.025]], rtol=1e-14)
    assert np.array_equal(read(TWO, motor_inertia=2e-5, gear_ratio=100).M_m, 0.2 * np.eye(2))


# Limits.


@pytest.mark.parametrize(
    ("inner", "kind", "expected"),
    [
        ('<limit lower="-1" upper="2" velocity="3" effort="4"/>', "revolute", [-1, 2, 3, 4]),
        ('<limit lower="0" upper="2" velocity="3" effort="4"/>', "prismatic", [0, 2, 3, 4]),
        ('<limit lower="-1" upper="2" velocity="0" effort="0"/>', "revolute", [-1, 2, np.inf, np.inf]),
        ('<limit lower="0" upper="0" velocity="3" effort="4"/>', "revolute", [-np.inf, np.inf, 3, 4]),
        ('<limit velocity="3" effort="4"/>', "continuous", [-np.inf, np.inf, 3, 4]),
        ('<limit lower="-1" upper="2" velocity="3" effort="4"/>', "continuous", [-np.inf, np.inf, 3, 4]),
        ('<limit effort="inf"/>', "revolute", [-np.inf, np.inf, np.inf, np.inf]),
        ("", "revolute", [-np.inf, np.inf, np.inf, np.inf]),
    ],
)
def test_zero_or_absent_limits_are_no_limits(inner: str, kind: str, expected: list[float]) -> None:
    limits = read(limited(inner, kind), ["shoulder"]).limits
    assert [float(getattr(limits, name)[0]) for name in ("lower", "upper", "velocity", "effort")] == expected


def test_limits_have_the_named_order() -> None:
    limits = fjr.robot_from_urdf(ARM7, ARM7_JOINTS[::-1], 1e4, 0.5).limits
    assert limits.effort.tolist() == [40, 40, 110, 110, 110, 176, 176]
    assert not limits.effort.flags.writeable


# Mimicking joints.


FINGERS = (
    link("left", com=0.2),
    link("right", com=0.3),
    joint("left_finger", "lower", "left", "prismatic"),
    joint("right_finger", "lower", "right", "prismatic", '<mimic joint="left_finger" multiplier="-2" offset="0.1"/>'),
)
HAND = TWO.replace("</robot>", "".join(FINGERS) + "</robot>")


def test_a_mimicking_joint_is_locked_at_the_position_of_its_leader() -> None:
    positions = {"left_finger": 0.3, "right_finger": -0.5}
    oracle = PinocchioLinks(pin.buildModelFromXML(with_limits(HAND)), ["shoulder", "elbow"], positions)
    assert agreement(read(HAND, locked={"left_finger": 0.3}), oracle, seed=0) < 1e-10


def with_limits(xml: str) -> str:
    """Add a <limit> to every joint, which Pinocchio requires but robot_from_urdf does not."""
    return xml.replace("</joint>", '<limit lower="0" upper="0" effort="0" velocity="0"/></joint>')


def with_inertia(ixx: float, iyy: float, izz: float) -> str:
    """Return the URDF of two links of which the first has other principal inertias."""
    other = f'ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"'
    return TWO.replace(ZERO.replace('iyy="0"', 'iyy="0.01"'), other, 1)


ANTENNA = link("antenna", inertia=ZERO.replace('iyy="0"', 'iyy="-1"')) + joint("mast", "base", "antenna", "fixed")
HUB = link("hub", mass=-2.0) + joint("wheel", "base", "hub", "continuous")
DOUBTED = {
    "link 'antenna' has the principal inertia -1; expected 0 or more; link 'hub' has the mass -2.0; "
    "expected 0 or more; ignored, since no chosen joint moves them": with_more(ANTENNA, HUB),
    "link 'upper' has principal inertias of 0.01, 0.02 and 0.031 kg m^2; "
    "expected the largest to be at most the sum of the others": with_inertia(0.01, 0.031, 0.02),
    "link 'upper' has 1 kg and an inertia of 90 kg m^2, "
    "a radius of gyration of 9.49 m; expected at most 5 m": with_inertia(90, 90, 90),
    "joint 'shoulder' has the origin (0.0, 0.0, 0.0) m, (0.0, 0.0, 0.0) rad and limits of -170 and 170; "
    "expected m and rad, at most 50": TWO.replace("</joint>", '<limit lower="-170" upper="170"/></joint>', 1),
    "joint 'elbow' has the origin (0.0, 0.0, -300.0) m, (0.0, 0.0, 0.0) rad and limits of -inf and inf; "
    "expected m and rad, at most 50": TWO.replace('"0 0 -0.3"', '"0 0 -300"'),
    "joint 'elbow' has the origin (0.0, 0.0, -0.3) m, (90.0, 0.0, 0.0) rad and limits of -inf and inf; "
    "expected m and rad, at most 50": TWO.replace('"0 0 -0.3"', '"0 0 -0.3" rpy="90 0 0"'),
}
"""URDFs by the warning that each gives: bodies that no chosen joint moves, bodies that are none, mm and degrees."""


@pytest.mark.parametrize("warning", DOUBTED)
def test_a_doubtful_urdf_is_read_with_one_warning(warning: str, caplog: pytest.LogCaptureFixture) -> None:
    found = read(DOUBTED[warning])
    assert [record.getMessage() for record in caplog.records] == [warning]
    if "no chosen joint" in warning:
        q = np.array([0.4, -0.7])
        assert np.array_equal(found.M_l(q), read(TWO).M_l(q))


def test_limits_without_end_are_no_warning(caplog: pytest.LogCaptureFixture) -> None:
    read(limited('<limit lower="-1e16" upper="1e16"/>'), ["shoulder"])
    assert not caplog.records


# Invalid input: one sentence, nothing printed.

POINT = link("lower", 1.0, 0.0, ZERO)
SIDE = with_more(link("other"), joint("wing", "upper", "other"))
HOOK = link("hook", inertia=ZERO.replace('iyy="0"', 'iyy="-1"')) + joint("wrist", "lower", "hook")
FIXED = with_more('<link name="camera"/>', joint("mount", "lower", "camera", "fixed"), xml=HAND)
REFUSED: dict[str, tuple[str, str]] = {
    "broken": ("<robot", "the URDF text does not parse as XML"),
    "not a urdf": ("<sdf/>", "root element <sdf>; expected the <robot> of a URDF"),
    "xacro": ('<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include/></robot>', "expected a plain URDF"),
    "empty": ("<robot/>", "the URDF has no <link>"),
    "two links of a name": (TWO.replace('link name="lower"', 'link name="upper"'), "a link named 'upper' twice"),
    "no name": (TWO.replace('link name="lower"', "link"), "a link named None twice or without a name"),
    "unknown type": (TWO.replace('"revolute"', '"hinge"', 1), "joint 'shoulder' has the type 'hinge'; expected one of"),
    "unknown link": (TWO.replace('child link="lower"', 'child link="fore"'), "joint 'elbow' names the link 'fore'"),
    "no child": (TWO.replace('<child link="lower"/>', ""), "joint 'elbow' has no <child link"),
    "two parents": (
        with_more(joint("rod", "base", "lower")),
        "link 'lower' is the child of joints 'elbow' and 'rod' .a closed chain.; expected a tree",
    ),
    "loop": (
        robot(BASE, link("upper"), link("lower"), joint("shoulder", "lower", "upper"), ELBOW),
        "is its own ancestor .a closed chain.; expected a tree",
    ),
    "two roots": (with_more(link("loose")), "links base, loose have no parent joint"),
    "floating base": (
        with_more('<link name="world"/>', joint("free", "world", "base", "floating")),
        "joint 'free' is floating; expected an arm with a fixed base",
    ),
    "zero axis": (TWO.replace('axis xyz="0 1 0"', 'axis xyz="0 0 0"', 1), "joint 'shoulder' has the axis 0 0 0"),
    "short axis": (TWO.replace('axis xyz="0 1 0"', 'axis xyz="0 1"', 1), '<axis xyz="0 1">; expected 3 numbers'),
    "word in origin": (TWO.replace('"0 0 -0.3"', '"0 0 a"'), "joint 'elbow' has <origin xyz=\"0 0 a\">; expected 3"),
    "no mass": (TWO.replace('<mass value="1.0"/>', "", 1), "link 'upper' has no <mass value=...>; expected a number"),
    "mass zero": (TWO.replace('value="1.0"', 'value="0"', 1), "link 'upper' has the mass 0 and an inertia; expected"),
    "negative mass": (TWO.replace('value="1.0"', 'value="-1"', 1), "link 'upper' has the mass -1.0; expected 0"),
    "negative inertia": (TWO.replace('iyy="0.01"', 'iyy="-1"', 1), "link 'upper' has the principal inertia -1"),
    "bad inertia beyond a locked joint": (with_more(HOOK), "link 'hook' has the principal inertia -1; expected 0 or"),
    "mass on the axis": (robot(BASE, link("upper"), POINT, SHOULDER, ELBOW), "joint 'elbow' can move without moving"),
    "all massless": (
        robot(BASE, '<link name="upper"/>', '<link name="lower"/>', SHOULDER, ELBOW),
        "joint 'elbow' can move without moving mass .M_l is singular.; expected links with mass and inertia beyond it",
    ),
    "range upside down": (
        limited('<limit lower="1" upper="-1"/>'),
        "joint 'shoulder' has <limit> lower=1 upper=-1 velocity=0 effort=0; expected lower <= upper",
    ),
    "negative effort": (limited('<limit effort="-1"/>'), "expected lower <= upper, velocity and effort 0 or more"),
    "nan limit": (limited('<limit effort="nan"/>'), "joint 'shoulder' has <limit effort=\"nan\">; expected a number"),
    "mimics a named joint": (
        HAND.replace('mimic joint="left_finger"', 'mimic joint="elbow"'),
        "joint 'right_finger' mimics the named joint 'elbow'",
    ),
    "mimics itself": (HAND.replace('mimic joint="left_finger"', 'mimic joint="right_finger"'), "mimics itself"),
    "mimics nobody": (HAND.replace('mimic joint="left_finger"', 'mimic joint="thumb"'), "no joint 'thumb'"),
}
ASKED: dict[str, tuple[str, dict[str, Any], str]] = {
    "unknown joint": (TWO, {"joints": ["sholder", "elbow"]}, "no joint 'sholder'; did you mean 'shoulder'. expected"),
    "far off": (TWO, {"joints": ["x"]}, "no joint 'x'; expected some of shoulder, elbow"),
    "a word": (TWO, {"joints": "elbow"}, "joints is 'elbow'; expected a list of joint names"),
    "fixed": (FIXED, {"joints": ["mount"]}, "joint 'mount' is fixed; expected a revolute, continuous, prismatic joint"),
    "mimic": (FIXED, {"joints": ["right_finger"]}, "joint 'right_finger' mimics 'left_finger'; expected joints that"),
    "branches": (SIDE, {"joints": ["shoulder", "elbow", "wing"]}, "'elbow' and 'wing' are on different branches after"),
    "stiffness": (TWO, {"stiffness": [1.0] * 3}, r"stiffness has shape \(3,\); expected a scalar"),
    "nan stiffness": (TWO, {"stiffness": [1.0, np.nan]}, "stiffness is .*; expected finite numbers"),
    "motor inertia": (TWO, {"motor_inertia": [1.0]}, r"motor_inertia has shape \(1,\)"),
    "gear ratio": (TWO, {"gear_ratio": [1.0]}, r"gear_ratio has shape \(1,\)"),
    "no gear": (TWO, {"gear_ratio": 0.0}, "gear_ratio is .*; expected numbers other than 0"),
    "gravity": (TWO, {"gravity": (0, np.nan, 0)}, "gravity is .*; expected finite numbers"),
    "locked unknown": (TWO, {"locked": {"elbwo": 0.0}}, "no joint 'elbwo'; did you mean 'elbow'"),
    "locked and named": (TWO, {"locked": {"elbow": 0.0}}, "joint 'elbow' is named and locked; expected one of the two"),
    "locked fixed": (FIXED, {"locked": {"mount": 0.1}}, "locked joint 'mount' is fixed"),
    "locked mimic": (FIXED, {"locked": {"right_finger": 0.1}}, "locked joint 'right_finger' mimics 'left_finger'"),
    "locked nan": (FIXED, {"locked": {"left_finger": np.nan}}, "position of locked joint 'left_finger' is .* finite"),
}


ALL = {**{what: (xml, {}, sentence) for what, (xml, sentence) in REFUSED.items()}, **ASKED}


@pytest.mark.parametrize("what", ALL)
def test_an_invalid_urdf_or_request_is_refused_in_one_sentence(what: str, capfd: pytest.CaptureFixture[str]) -> None:
    xml, values, sentence = ALL[what]
    with pytest.raises(fjr.RobotError, match=sentence) as refused:
        read(xml, **values)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")


def test_a_file_that_is_no_urdf_is_named(tmp_path: Path) -> None:
    binary = tmp_path / "arm.urdf"
    binary.write_bytes(b"\x00\xff\x7fELF")
    unread = "cannot be read .*; expected a file or XML text"
    for path, words in ((tmp_path / "none.urdf", unread), (tmp_path, unread), (binary, "does not parse as XML")):
        with pytest.raises(fjr.RobotError, match=f"URDF {path} {words}"):
            fjr.robot_from_urdf(path, ["a"], 1.0, 1.0)


# The seven-joint arm.


def arm7_links() -> dict[str, ET.Element]:
    return {str(link.get("name")): link for link in ET.parse(ARM7).getroot().findall("link")}


def attribute(element: ET.Element, path: str, name: str) -> Array:
    found = element.find(path)
    assert found is not None, path
    return np.array([float(word) for word in found.get(name, "0 0 0").split()])


@pytest.mark.parametrize("name", ["base_link", *(f"link{i}" for i in range(1, 8)), "tool"])
def test_every_link_of_arm7_has_the_inertia_of_its_visual_cylinder(name: str) -> None:
    element = arm7_links()[name]
    (m,), (r,) = attribute(element, "inertial/mass", "value"), attribute(element, "visual/geometry/cylinder", "radius")
    (h,) = attribute(element, "visual/geometry/cylinder", "length")
    R = pin.rpy.rpyToMatrix(attribute(element, "visual/origin", "rpy"))
    across = m * (3 * r**2 + h**2) / 12
    I_c = R @ np.diag([across, across, m * r**2 / 2]) @ R.T
    seen = [attribute(element, "inertial/inertia", key)[0] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    assert np.allclose(seen, [*np.diag(I_c), I_c[0, 1], I_c[0, 2], I_c[1, 2]], rtol=1e-5, atol=1e-12)
    assert np.array_equal(attribute(element, "inertial/origin", "xyz"), attribute(element, "visual/origin", "xyz"))
