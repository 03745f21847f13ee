# SPDX-License-Identifier: Apache-2.0
"""Files of arbitrary content are read or rejected in one sentence, in bounded time and memory."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_core.config import robot_file, ros_yaml
from fjr_core.config.scenario import load_scenario
from fjr_core.files import text_file
from fuzzing import answer, bytes_of, documents, fuzzed, texts
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

SCENARIO = """
/**:
  ros__parameters:
    joints: [joint1]
    robot: {model: single_link, joint_stiffness: [31.0], motor_inertia: [0.004], link_damping: [0.2]}
fjr_plant:
  ros__parameters: {publish_rate: 1000.0, initial_link_position: [0.5], compile: false, imperfections.state_delay: 0.0}
fjr_controller:
  ros__parameters:
    compile: false
    gains: {Lambda_l: [10.0], Pi_l: [20.0]}
    reference: {type: sine, amplitude: [1.0], frequency: [1.0]}
"""
ROBOT = f"/**:\n  ros__parameters:\n    joints: {JOINTS}\n    robot: {{urdf: arm.urdf, joint_stiffness: {STIFFNESS}}}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("hostile")
    assert load(made, SCENARIO) == "", "without a change the scenario must be valid"
    return made


def load(folder: Path, content: str | bytes) -> str:
    path = folder / "hostile.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
    return answer(lambda: load_scenario(path))


@fuzzed(120)
@given(content=st.one_of(documents(yaml.safe_load(SCENARIO)), texts(SCENARIO)))
def test_scenarios_with_misplaced_values_or_arbitrary_bytes(folder: Path, content: str | bytes) -> None:
    load(folder, content)


@fuzzed(60)
@given(text=documents(yaml.safe_load(ROBOT)))
def test_robot_files(folder: Path, text: str) -> None:
    (folder / "arm.urdf").write_text(two_link_urdf())
    (folder / "robot.yaml").write_text(text)
    answer(lambda: robot_file.inlined(robot_file.merged({"robot.file": "robot.yaml"}, "fjr_plant", folder)))


HOSTILE = {
    "impossible date": ("a: 2024-13-45", ""),
    "tag without content": ("a: !!int", "line 1"),
    "timestamp without content": ("a: !!timestamp ''", "line 1"),
    "tag of another kind": ("a: !!bool maybe", "maybe"),
    "digits that are none": ("a: 0x_", "0x_"),
    "long integer": ("a: " + "9" * 5000, "5000 characters"),
    "long sexagesimal": ("a: " + ":".join(["59"] * 3000), "characters"),
    "open brackets": ("[" * 10_000, "nested"),
    "brackets": ("[" * 10_000 + "]" * 10_000, "nested"),
    "200 kB of levels": ("\n".join(" " * i + "a:" for i in range(630)), "nested"),
    "half a surrogate pair": (r'a: "\ud800"', "line 1, column 7"),
    "NUL": (r'a: "b\0c"', "U+0000"),
    "alias": ("a: &x [1.0]\nb: *x\n", "alias"),
    "twice": ("/**/fjr_controller: {a: 1}\n/**/fjr_controller: {b: 2}\n", "'/**/fjr_controller' twice"),
}


@pytest.mark.parametrize(("text", "words"), HOSTILE.values(), ids=HOSTILE)
def test_expensive_or_meaningless_yaml_is_rejected(text: str, words: str) -> None:
    sentence = answer(lambda: ros_yaml.parse(text))
    assert words in sentence
    assert bool(sentence) == bool(words)


def test_too_many_values_are_rejected_before_construction(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_yaml, "MAX_NODES", 100)
    assert "more than 100 values" in answer(lambda: ros_yaml.parse("[" + "1, " * 200 + "]"))


def test_a_special_file_does_not_block(folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    for path in (folder / "pipe", "/dev/zero", folder, "a\0b", "\ud800", "x" * 5000):
        with pytest.raises(OSError, match=r".") as caught:
            text_file.read_text(path)
        assert caught.value.strerror
        assert answer(lambda path=path: fjr.robot_from_urdf(Path(path), ["a"], 1.0, 1.0))


def test_json_that_is_no_object_raises_value_error(folder: Path) -> None:
    for text in ("[" * 100_000, "[]", "{", '"a"', "\ud800"):
        path = folder / "some.json"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        with pytest.raises(ValueError, match=r"."):
            text_file.read_json(path)


WORDS = ["0", "-1", "1e308", "nan", "inf", "", "1_0", "0x10", "a", "1 2", "prismatic", "floating", "\u0661", "x" * 999]


@st.composite
def urdfs(draw: st.DrawFn) -> str:
    """Return URDFs of the arm in which some attributes have another value."""
    pieces = two_link_urdf().split('"')
    for _ in range(draw(st.integers(1, 3))):
        place = 2 * draw(st.integers(0, len(pieces) // 2 - 1)) + 1
        pieces[place] = draw(st.sampled_from([*WORDS, *pieces[1::2]]))
    return '"'.join(pieces)


def build(urdf: object) -> str:
    return answer(lambda: fjr.robot_from_urdf(urdf, JOINTS, STIFFNESS, MOTOR_INERTIA))


@fuzzed(120)
@given(data=st.one_of(urdfs().map(str.encode), bytes_of(two_link_urdf().encode())))
def test_urdfs_with_misplaced_values_or_arbitrary_bytes(folder: Path, data: bytes) -> None:
    (folder / "some.urdf").write_bytes(data)
    build(folder / "some.urdf")


def test_xml_entity_expansion_is_rejected() -> None:
    entities = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    assert "document type" in build(f'<!DOCTYPE robot [<!ENTITY e0 "x">{entities}]><robot name="&e9;"/>')
    assert "nested" in build("<robot>" + "<a>" * 100_000)
