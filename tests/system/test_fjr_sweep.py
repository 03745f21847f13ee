# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: real processes, one killed in the middle, and a real Dask cluster that loses a worker."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any

import matplotlib.image
import pyarrow.parquet as pq
import pytest

from fjr_design.studies.monte_carlo import command as monte_carlo_command
from fjr_design.studies.monte_carlo.pool import ClusterError, cluster, run_missing
from fjr_design.studies.monte_carlo.store import open_store
from fjr_msgs_py.console.ending import Exit
from system.executables import Executable, fjr, fjr_here
from time_limits import Limit

pytestmark = pytest.mark.system
SWEEP = """
scenario: paper_k31
runs: {runs}
duration: {duration}
seed: 11
vary:
  stiffness: {{uniform: [0.5, 1.5], each_joint: true}}
  delay: {{uniform: [0.0, 0.01]}}
  velocity_noise: 1.0e-3
success: {{rms: 0.05}}
settle_after: 0.2
"""


def sweep_file(folder: Path, runs: int = 120, duration: float = 0.5) -> str:
    path = folder / "joint.yaml"
    path.write_text(SWEEP.format(runs=runs, duration=duration))
    return str(path)


def table(folder: Path) -> bytes:
    return (folder / "joint" / "table.parquet").read_bytes()


def test_study_writes_a_table_a_figure_and_a_page(tmp_path: Path) -> None:
    said = fjr("sweep", sweep_file(tmp_path), "--output", str(tmp_path))
    columns = pq.read_table(tmp_path / "joint" / "table.parquet")
    assert columns.num_rows == 120
    assert columns.column("run").to_pylist() == list(range(120))
    assert {"stiffness.joint1", "delay", "success", "rms.joint1"} <= set(columns.column_names)
    figures = json.loads((tmp_path / "joint" / "summary.json").read_text())
    assert figures["succeeded"] == sum(columns.column("success").to_pylist())
    assert f"{100 * figures['succeeded'] / 120:.2f} % of 120 succeed" in said
    assert figures["effects"][0]["name"] == "delay"
    picture = matplotlib.image.imread(tmp_path / "joint" / "overview.png")
    assert picture[..., :3].std() > 0.05
    page = (tmp_path / "joint" / "report.html").read_text()
    assert "runs succeed" in page
    assert 'src="http' not in page


def test_all_cores_give_the_bytes_of_one_core(tmp_path: Path) -> None:
    name = sweep_file(tmp_path)
    fjr_here("sweep", name, "--output", str(tmp_path / "one"))
    fjr_here("sweep", name, "--cores", "all", "--output", str(tmp_path / "all"))
    assert table(tmp_path / "one") == table(tmp_path / "all")


def test_killed_study_is_resumed(tmp_path: Path) -> None:
    name = sweep_file(tmp_path, runs=800, duration=3.0)
    running = Executable("fjr_bringup", "fjr", "sweep", name, "--output", str(tmp_path / "killed"))
    parts = tmp_path / "killed" / "joint" / "parts"
    try:
        wait_for(lambda: len(list(parts.glob("*.parquet"))) >= 3, running)
        running.signal(signal.SIGKILL)
        assert running.process.wait(timeout=10) == -signal.SIGKILL
    finally:
        running.kill()
    kept = {path: path.stat().st_mtime_ns for path in parts.glob("*.parquet")}
    assert 3 <= len(kept) < 80
    said = fjr_here("sweep", name, "--cores", "all", "--output", str(tmp_path / "killed"))
    assert f"{10 * len(kept)} of 800 runs are finished already" in said
    fjr_here("sweep", name, "--cores", "all", "--output", str(tmp_path / "whole"))
    assert table(tmp_path / "killed") == table(tmp_path / "whole")


def test_ctrl_c_keeps_finished_parts(tmp_path: Path) -> None:
    name = sweep_file(tmp_path, runs=800, duration=3.0)
    running = Executable("fjr_bringup", "fjr", "sweep", name, "--output", str(tmp_path))
    try:
        wait_for(lambda: any((tmp_path / "joint" / "parts").glob("*.parquet")), running)
        running.signal(signal.SIGINT)
        code, said = running.end()
    finally:
        running.kill()
    assert code == Exit.INTERRUPTED
    assert f"what was recorded is in {tmp_path / 'joint'}" in said


@pytest.mark.parametrize(
    ("change", "words", "code"),
    [
        (["--runs", "60"], "runs is 120, not 60", 1),
        (["--set", "gains.K_ld:=[0.7]"], "scenario_text differs", 1),
        (["--scheduler", "tcp://127.0.0.1:{free}"], "no Dask scheduler answers at tcp://127.0.0.1", 1),
        (["--scheduler", "nowhere"], "address is 'nowhere'; expected e.g. tcp://", 1),
        (["--cores", "none"], "expected 1 or more, or all", 2),
        (["--runs", "0"], "expected 1 or more", 2),
    ],
)
def test_invalid_arguments_are_refused_in_one_sentence(
    tmp_path: Path, change: list[str], words: str, code: int
) -> None:
    name = sweep_file(tmp_path)
    with open_store(tmp_path / "joint", *_planned(name)):
        pass
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        change = [word.format(free=free.getsockname()[1]) for word in change]
        said = fjr_here("sweep", name, *change, "--output", str(tmp_path), code=code)
    assert words in said


def test_parameter_name_that_is_no_text_is_refused_in_one_sentence(tmp_path: Path) -> None:
    name = sweep_file(tmp_path)
    Path(name).write_text(Path(name).read_text() + "set: {5: 1}\n")
    said = fjr_here("sweep", name, "--output", str(tmp_path), code=2)
    assert "the name of a parameter is 5; expected text" in said
    assert "Traceback" not in said


def test_unknown_name_and_invalid_file_are_refused_in_one_sentence(tmp_path: Path) -> None:
    assert "or of the sweeps arm7_tune, paper_joint" in fjr_here("sweep", "no_such", code=2)
    wrong = Path(sweep_file(tmp_path))
    wrong.write_text(wrong.read_text().replace("uniform", "unifrom", 1))
    assert "expected {uniform" in fjr_here("sweep", str(wrong), code=2)


@pytest.mark.slow
def test_dask_cluster_that_loses_a_worker_gives_the_same_bytes(tmp_path: Path, local_cluster: Any) -> None:
    from distributed import Client

    name = sweep_file(tmp_path, runs=300, duration=3.0)
    fjr_here("sweep", name, "--cores", "all", "--output", str(tmp_path))
    address, killed, after = local_cluster.scheduler_address, [], [0]

    def lose_one(runs: int) -> None:
        after[0] += runs
        if after[0] == 100:
            with Client(address, set_as_default=False) as client:
                killed.extend(sorted(client.run(os.getpid).values())[:1])
            os.kill(killed[0], signal.SIGKILL)

    with open_store(tmp_path / "cluster", *_planned(name)) as store, cluster(address) as workers:
        assert workers.count == 2
        assert run_missing(store, workers, lose_one, threading.Event())
        assert store.complete().read_bytes() == table(tmp_path)
    assert killed
    assert not Path(f"/proc/{killed[0]}/stat").exists() or "Z" in Path(f"/proc/{killed[0]}/stat").read_text()


@pytest.mark.slow
def test_fjr_sweep_runs_on_an_existing_scheduler(tmp_path: Path, local_cluster: Any) -> None:
    name = sweep_file(tmp_path)
    fjr_here("sweep", name, "--output", str(tmp_path / "one"))
    said = fjr_here(
        "sweep", name, "--scheduler", local_cluster.scheduler_address, "--output", str(tmp_path / "cluster")
    )
    assert "120 runs on 2 cores" in said
    assert table(tmp_path / "one") == table(tmp_path / "cluster")


def test_missing_dask_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    wanted = pytest.raises(ClusterError, match="dask.distributed is not installed here; .*pip install distributed")
    with wanted, cluster("tcp://127.0.0.1:8786"):
        pass


def _planned(name: str) -> tuple[Any, str]:
    wish = monte_carlo_command.Options(1, None, Path(), {}, {})
    plan = monte_carlo_command.planned(name, wish)
    return plan, plan.loop.fingerprint


def wait_for(found: Any, running: Executable) -> None:
    limit = Limit(60.0)
    while not found():
        assert running.process.poll() is None, running.end()
        assert not limit.passed()
        time.sleep(0.01)
