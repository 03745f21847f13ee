# SPDX-License-Identifier: Apache-2.0
"""The command line of `fjr`: help without slow imports, options that need no value, completion."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import click
import pytest

from fjr_bringup.cli.app import GROUPS, fjr, main
from fjr_msgs_py.console.ending import Exit
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
    assert main(["--version"]) == Exit.DONE
    assert capsys.readouterr().out == "fjr 0.1.0\n"
    for command in fjr.commands.values():
        assert command.help
        assert "..." not in command.get_short_help_str(61)
        assert all(each.help for each in command.params if isinstance(each, click.Option))


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
