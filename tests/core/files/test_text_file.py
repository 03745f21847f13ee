# SPDX-License-Identifier: Apache-2.0
"""A file is whole at any time, whoever else writes it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from fjr_core.files.text_file import whole_file

OTHER = """
import sys
from pathlib import Path
from fjr_core.files.text_file import write_text
write_text(Path(sys.argv[1]), "theirs")
"""


def test_two_processes_that_write_a_file_at_once_do_not_mix(tmp_path: Path) -> None:
    file = tmp_path / "values.yaml"
    with whole_file(file) as scratch:
        scratch.write_text("mine")
        subprocess.run([sys.executable, "-c", OTHER, str(file)], check=True)
        assert (file.read_text(), scratch.read_text()) == ("theirs", "mine")
    assert file.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [file]
