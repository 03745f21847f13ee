# SPDX-License-Identifier: Apache-2.0
"""`fjr gains --write` replaces the gains in a scenario's file and leaves every other character of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from fjr_core.config import ros_yaml
from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.scenario import load_scenario
from fjr_core.errors import ParameterError
from fjr_msgs_py.scenarios.gains_block import with_gains
from system.executables import fjr_here, scenario

pytestmark = pytest.mark.system

GAINS = {"Lambda_l": [9.0, 9.0], "K_ld": [1.0, 0.5, 0.5, 2.0]}
NEW = "      Lambda_l: [9.0, 9.0]\n      K_ld: [1.0, 0.5,\n             0.5, 2.0]"
HEAD = """# My arm.
/**:
  ros__parameters:
    robot: {file: "package://fjr_bringup/robots/two_link.yaml"}   # the robot
"""
BLOCK = """    gains:   # tuned on Monday
      Lambda_l: [1.0, 1.0]   # 1/s
      # the old link damping
      Gamma_l: [0.1, 0.1]
    law: {type: v_dpbc}
"""
REPLACED = BLOCK.replace("[1.0, 1.0]", "[9.0, 9.0]").replace("      Gamma_l: [0.1, 0.1]", NEW.partition("\n")[2])
OWN = HEAD + "/**/fjr_controller:\n  ros__parameters:\n    gains:\n"
CASES = {
    "replaced": (HEAD + BLOCK, HEAD + REPLACED),
    "new block": (HEAD, HEAD.replace("    robot:", f"    gains:\n{NEW}\n    robot:")),
    "flow": (HEAD + "    gains: {Lambda_l: [1.0, 1.0]}   # short\n", HEAD + f"    gains: \n{NEW}   # short\n"),
    "own section": (OWN + "      Lambda_l: [1.0, 1.0]", OWN + NEW + "\n"),
}


@pytest.mark.parametrize("case", CASES)
def test_everything_but_the_gains_stays(case: str) -> None:
    before, after = CASES[case]
    assert with_gains(before, GAINS, 2) == after


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "    gains.Lambda_l: [1.0, 1.0]\n", "expected one block `gains:`"),
        ("/**: {ros__parameters: {joints: [a, b]}}\n", "no block `ros__parameters:` for the controller"),
        ("/**/fjr_plant:\n  ros__parameters: {}\n", "no block `ros__parameters:` for the controller"),
        (HEAD + BLOCK + "/**/fjr_controller:\n  ros__parameters:\n    gains.K_ld: [1.0, 1.0]\n", "expected one block"),
    ],
)
def test_a_file_without_a_place_for_gains_is_refused(text: str, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        with_gains(text, GAINS, 2)


def test_the_written_gains_are_those_that_are_printed_and_load(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    text = Path(scenario("two_link")).read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    said = fjr_here("gains", str(path), "--beta", "5", "--write")
    assert f"# written to {path}:" in said
    gains = ros_yaml.parse(said[said.index("    gains:") :])["gains"]
    values = ros_yaml.values_for(CONTROLLER, ros_yaml.parse(path.read_text(encoding="utf-8")))
    assert {name: values[f"gains.{name}"] for name in gains} == gains
    comments = [line.partition("#")[2] for line in text.splitlines() if "#" in line]
    assert [line.partition("#")[2] for line in path.read_text(encoding="utf-8").splitlines() if "#" in line] == comments
    assert load_scenario(path).law.rate().beta >= 5
