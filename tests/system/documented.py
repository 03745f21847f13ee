# SPDX-License-Identifier: Apache-2.0
"""The keys of the JSON that each command prints, as docs/tables/json.md lists them."""

from __future__ import annotations

import re

from docs.pages import ROOT

ROW = re.compile(r"^\| (`fjr [^|]*) \| ([^|]*) \|$", re.MULTILINE)
OPTIONAL = re.compile(r"; with [^;]*")
CODE = re.compile(r"`([^`]*)`")


def documented_keys() -> dict[str, set[str]]:
    """Return the keys in the second column of the table by command, without those of an option ("; with ...;")."""
    page = (ROOT / "docs" / "tables" / "json.md").read_text(encoding="utf-8")
    section = page.partition("## Results of commands\n")[2].partition("\n## ")[0]
    rows = {names: set(CODE.findall(OPTIONAL.sub("", keys))) for names, keys in ROW.findall(section)}
    return {name.removeprefix("fjr "): keys for names, keys in rows.items() for name in CODE.findall(names)}
