# SPDX-License-Identifier: Apache-2.0
"""Folders of the runs of a scenario: none is overwritten, and the name of the scenario links to the newest."""

from __future__ import annotations

from pathlib import Path

import pytest

from fjr_monitor.recording.run_folder import FolderError, RunFolder


def new_run(link: Path, text: str) -> Path:
    """Create a started run with a bag."""
    with RunFolder(link) as run:
        (run.path / "bag").mkdir()
        (run.path / "bag" / "bag_0.mcap").write_text(text)
        run.keep()
    return run.path


def test_every_run_is_kept_and_the_link_points_to_the_newest(tmp_path: Path) -> None:
    runs = [new_run(tmp_path / "arm", str(k)) for k in range(3)]
    assert [run.name for run in runs] == ["arm-001", "arm-002", "arm-003"]
    assert [(run / "bag" / "bag_0.mcap").read_text() for run in runs] == ["0", "1", "2"]
    assert (tmp_path / "arm").resolve() == runs[-1]


def test_run_that_could_not_start_leaves_no_folder(tmp_path: Path) -> None:
    first = new_run(tmp_path / "arm", "0")
    with RunFolder(tmp_path / "arm") as run:
        (run.path / "scenario.yaml").write_text("")
    assert {path.name for path in tmp_path.iterdir()} == {"arm", "arm-001"}
    assert (tmp_path / "arm").resolve() == first


def test_a_number_is_used_once(tmp_path: Path) -> None:
    first, second = new_run(tmp_path / "arm", "0"), new_run(tmp_path / "arm", "1")
    first.rename(tmp_path / "published")
    with RunFolder(tmp_path / "arm") as one, RunFolder(tmp_path / "arm") as other:
        assert one.path != other.path
        assert "arm-001" not in (one.path.name, other.path.name)
    assert second.is_dir()


def test_a_run_without_a_number_gets_one(tmp_path: Path) -> None:
    (tmp_path / "arm" / "bag").mkdir(parents=True)
    (tmp_path / "arm" / "bag" / "bag_0.mcap").write_text("old")
    assert new_run(tmp_path / "arm", "new").name == "arm-002"
    assert (tmp_path / "arm-001" / "bag" / "bag_0.mcap").read_text() == "old"


def test_other_folders_than_empty_ones_are_not_changed(tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    new_run(tmp_path / "arm", "replaces the empty folder")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "text").write_text("")
    (tmp_path / "link").symlink_to("thesis")
    for name in ("thesis", "link"):
        with pytest.raises(FolderError, match="not replaced"), RunFolder(tmp_path / name):
            pass
