# SPDX-License-Identifier: Apache-2.0
"""docs/reports.md lists the exit codes of `fjr` as `fjr --help` does."""

from __future__ import annotations

import re

import click

from docs.pages import ROOT
from fjr_bringup.cli.app import fjr
from fjr_bringup.cli.exit_codes import MEANINGS, Exit


def test_every_exit_code_is_documented() -> None:
    page = (ROOT / "docs" / "reports.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| (.*) \|$", page, flags=re.MULTILINE)
    assert {int(code): meaning for code, meaning in rows} == {code.value: MEANINGS[code] for code in Exit}
    said = fjr.get_help(click.Context(fjr, info_name="fjr"))
    assert all(f"  {code:<4} {meaning.replace('`', '')}" in said for code, meaning in MEANINGS.items())
