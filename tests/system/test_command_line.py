# SPDX-License-Identifier: Apache-2.0
"""The command line of `fjr`: help without slow imports, options that need no value, numbers that are refused."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from xml.etree import ElementTree

import click
import pytest

from fjr_bringup.cli.app import GROUPS, fjr, main
from fjr_core.config.scenario import load_scenario
from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here, scenario
from time_limits import HANG

pytestmark = pytest.mark.system
SLOW = ("numpy", "casadi", "rclpy", "matplotlib", "scipy", "pyarrow")


def given(*words: str) -> dict[str, object]:
    """Return the parameters that a command is called with."""
    command = fjr.commands[words[0]]
    return dict(command.make_context(words[0], list(words[1:]), obj=lambda: None).params)


def test_help_scenarios_and_usage_errors_import_nothing_slow() -> None:
    lines = ("--help", "--version", "run --help", "run --duration no", "scenarios", "scenarios --json")
    code = f"import sys; from fjr_bringup.cli.app import main\nfor line in {lines!r}:\n    main(line.split()); "
    code += f"print('loaded:', *sorted(set({SLOW!r}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=HANG, check=True)
    loaded = [line for line in done.stdout.splitlines() if line.startswith("loaded:")]
    assert loaded == ["loaded:"] * len(lines)


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == Exit.DONE
    assert capsys.readouterr().out == "fjr 0.1.0\n"


def test_the_help_has_ten_commands_in_three_groups_and_all_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    assert [*GROUPS] == ["Run", "Your robot", "Studies"]
    assert sum(map(len, GROUPS.values())) <= 10
    assert main(["--help"]) == Exit.DONE
    short = listed(capsys.readouterr().out)
    assert short == [name for names in GROUPS.values() for name in names]
    assert main(["help", "all"]) == Exit.DONE
    assert set(listed(capsys.readouterr().out)) == {name for name, each in fjr.commands.items() if not each.hidden}
    assert main(["help", "run"]) == Exit.DONE
    assert capsys.readouterr().out.startswith("Usage: fjr run [OPTIONS]")
    assert main(["help", "nothing"]) == Exit.NOT_UNDERSTOOD


def listed(text: str) -> list[str]:
    """Return the commands that a help lists."""
    return [name for name in re.findall(r"^  ([a-z][a-z0-9-]*)  ", text, re.MULTILINE) if name in fjr.commands]


def test_a_reader_that_ends_early_ends_the_command_quietly() -> None:
    read, write = os.pipe()
    os.close(read)
    code = "import sys; from fjr_bringup.cli.app import main; sys.exit(main(['scenarios']))"
    done = subprocess.run([sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, text=True, timeout=HANG)
    os.close(write)
    assert (done.returncode, done.stderr) == (Exit.FAILED, "")


@pytest.mark.parametrize("name", fjr.commands)
def test_every_command_and_option_has_help(name: str) -> None:
    command = fjr.commands[name]
    assert command.help
    assert "..." not in command.get_short_help_str(61)
    assert all(each.help for each in command.params if isinstance(each, click.Option))


@pytest.mark.parametrize("arguments", [[], ["unknown"], ["run", "--unknown"], ["report"], ["gains", "arm7"]])
def test_missing_or_unknown_arguments_exit_with_the_usage_error_code(arguments: Sequence[str]) -> None:
    assert main(arguments) == Exit.NOT_UNDERSTOOD


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "--duration", "nan"], "'nan' is not a duration; expected seconds"),
        (["run", "--duration", "3601"], "'3601' is not a duration"),
        (["watch", "--namespace", "a b"], "'a b' is not a ROS name; expected letters"),
        (["watch", "--controller", "1st"], "'1st' is not a ROS name"),
        (["gains", "arm7", "--beta", "inf"], "'inf' is not a rate; expected a positive number"),
        (["sweep", "--runs", "1.5"], "'1.5' is not a number of runs; expected 1 or more"),
        (["sweep", "--cores", "0"], "'0' is not a number of cores; expected 1 or more, or all"),
        (["watch", "--remap", "a:="], "'a:=' is not a remap; expected FROM:=TO"),
    ],
)
def test_invalid_numbers_and_remaps_are_named(
    arguments: Sequence[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == Exit.NOT_UNDERSTOOD
    assert words in capsys.readouterr().err


def test_options_with_an_optional_value() -> None:
    assert str(given("compare", "--document")["document"]) == "docs/tables/compare.md"
    assert str(given("compare", "quick", "--document", "other.md")["document"]) == "other.md"
    assert given("compare")["document"] is None
    assert given("compare")["suite"] == "paper"
    assert given("echo", "/t")["count"] is None
    assert given("echo", "/t", "--once")["count"] == 1
    assert given("echo", "/t", "--count", "3")["count"] == 3
    assert given("sweep", "--runs", "1e4")["runs"] == 10_000
    assert given("sweep", "--cores", "all")["cores"] == len(os.sched_getaffinity(0))


def test_the_shell_completes_commands_scenarios_and_parameters(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_FJR_COMPLETE", "bash_complete")
    for line, expected in (
        ("fjr export-c", "export-c"),
        ("fjr run paper_k31", "paper_k31"),
        ("fjr run two_link --set lockstep_t", "lockstep_timeout:="),
        ("fjr check arm7 --set limits.start_err", "limits.start_error:="),
    ):
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(line.split()) - 1))
        with pytest.raises(SystemExit):
            main(line.split()[1:])
        assert capsys.readouterr().out == f"plain,{expected}\n"


@pytest.mark.parametrize("name", ["paper_k31", "two_link", "arm7"])
def test_description_has_the_joints_of_the_scenario(name: str) -> None:
    robot = ElementTree.fromstring(fjr_here("description", name))
    assert set(load_scenario(scenario(name)).joints) <= {joint.get("name") for joint in robot.iter("joint")}


def test_description_includes_parameters_of_the_command_line() -> None:
    light, heavy = (fjr_here("description", "two_link", "--set", f"robot.link_mass:=[{m}, 0.8]") for m in (1.2, 2.5))
    assert '<mass value="1.2"' in light
    assert '<mass value="2.5"' in heavy
