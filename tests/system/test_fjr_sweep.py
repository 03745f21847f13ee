# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: real processes, one killed in the middle, a Dask cluster that loses a worker, the page."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import threading
from pathlib import Path
from typing import Any

import matplotlib.image
import pyarrow.parquet as pq
import pytest

from fjr_design.studies.study import Columns, WorkerError, cluster, open_store
from fjr_design.studies.sweep import Sweep, planned
from fjr_design.studies.sweep_run import carry_out, jobs_of
from system.browser import Browser
from system.executables import Start, documented_keys, fjr_here, wait_for
from time_limits import HANG

pytestmark = pytest.mark.system
SWEEP = """
scenario: paper_k31
runs: {}
duration: 3.0
seed: 11
vary:
  stiffness: {{uniform: [0.5, 1.5], each_joint: true}}
  delay: {{uniform: [0.0, 0.01]}}
  velocity_noise: 1.0e-3
success: {{rms: 0.05}}
settle_after: 0.2
"""


def sweep_file(folder: Path, runs: int) -> str:
    path = folder / "joint.yaml"
    path.write_text(SWEEP.format(runs))
    return str(path)


def table(folder: Path) -> bytes:
    return (folder / "joint" / "table.parquet").read_bytes()


def test_killed_study_is_resumed(start: Start, tmp_path: Path) -> None:
    name = sweep_file(tmp_path, 200)
    running, parts = start("fjr", "sweep", name, "--output", str(tmp_path / "killed")), tmp_path / "killed/joint/parts"
    wait_for(lambda: len(list(parts.glob("*.parquet"))) >= 3 or running.process.poll() is not None, "three parts")
    running.signal(signal.SIGKILL)
    assert running.process.wait(HANG) == -signal.SIGKILL
    kept = list(parts.glob("*.parquet"))
    assert 3 <= len(kept) < 20
    said = fjr_here("sweep", name, "--cores", "all", "--output", str(tmp_path / "killed"))
    assert f"{10 * len(kept)} of 200 runs are finished already" in said
    fjr_here("sweep", name, "--cores", "all", "--output", str(tmp_path / "whole"))
    assert table(tmp_path / "killed") == table(tmp_path / "whole")


@pytest.mark.slow
def test_dask_cluster_that_loses_a_worker_gives_the_same_bytes(tmp_path: Path, local_cluster: Any) -> None:
    from distributed import Client

    name = sweep_file(tmp_path, 150)
    fjr_here("sweep", name, "--cores", "all", "--output", str(tmp_path))
    address, killed, after = local_cluster.scheduler_address, [], [0]

    def lose_one(columns: Columns) -> None:
        after[0] += len(columns["run"])
        if after[0] == 50:
            with Client(address, set_as_default=False) as client:
                killed.extend(sorted(client.run(os.getpid).values())[:1])
            os.kill(killed[0], signal.SIGKILL)

    plan = planned(name)
    with open_store(tmp_path / "cluster", plan.text, "program") as store, cluster(address) as workers:
        assert workers.count == 2
        store.run(workers, Sweep.part, jobs_of(plan), threading.Event(), lose_one)
        assert carry_out(plan, store, workers, threading.Event()).read_bytes() == table(tmp_path)
    assert killed
    assert not Path(f"/proc/{killed[0]}/stat").exists() or "Z" in Path(f"/proc/{killed[0]}/stat").read_text()


def test_a_scheduler_without_address_answer_or_program_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    line = ("sweep", sweep_file(tmp_path, 20), "--scheduler", "nowhere", "--output", str(tmp_path))
    assert "address is 'nowhere'; expected e.g. tcp://" in fjr_here(*line, code=1)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        words = f"no Dask scheduler answers at {address}"
        with pytest.raises(WorkerError, match=words), cluster(address, timeout=0.5):
            pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = "dask.distributed is not installed here; .*pip install distributed"
    with pytest.raises(WorkerError, match=words), cluster("tcp://127.0.0.1:8786"):
        pass


PAGE = """
scenario: paper_k31
runs: 160
duration: 0.5
vary:
  delay: {uniform: [0.0, 0.01]}
  link_damping: {log_uniform: [0.5, 2.0]}
success: {rms: 0.05}
settle_after: 0.2
"""
FIGURES = ["share-0", "runs-0", "share-1", "runs-1", "distribution"]
LARGEST = 3e6  # bytes


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the sweep of the page; return its folder, with what the command said."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "joint.yaml").write_text(PAGE)
    said = fjr_here("sweep", str(folder / "joint.yaml"), "--output", str(folder), "--json")
    (folder / "joint" / "said").write_text(said)
    return folder / "joint"


def test_sweep_writes_a_table_a_figure_and_a_page(study: Path) -> None:
    columns = pq.read_table(study / "table.parquet")
    assert columns.num_rows == 160
    assert columns.column("run").to_pylist() == list(range(160))
    assert {"delay", "link_damping", "success", "rms.joint1"} <= set(columns.column_names)
    assert set(json.JSONDecoder().raw_decode((study / "said").read_text())[0]) == documented_keys()["sweep"]
    figures = json.loads((study / "summary.json").read_text())
    assert figures["succeeded"] == sum(columns.column("success").to_pylist())
    assert figures["effects"][0]["name"] == "delay"
    assert matplotlib.image.imread(study / "overview.png")[..., :3].std() > 0.05
    assert "runs succeed" in (study / "report.html").read_text()


@pytest.mark.usefixtures("no_picture")
def test_a_sweep_without_matplotlib_names_what_it_leaves_out(study: Path) -> None:
    figures = json.loads((study / "summary.json").read_text())
    again = fjr_here("sweep", f"{study}.yaml", "--output", str(study.parent))
    assert f"{study / 'overview.png'} is left out" in again
    assert f"open {study / 'report.html'}" in again
    assert f"{100 * figures['succeeded'] / 160:.2f} % of 160 runs succeed" in again


def test_page_draws_all_plots_and_the_influence_at_any_width(study: Path, browser: Browser) -> None:
    page = study / "report.html"
    assert page.stat().st_size < LARGEST
    browser.draws(page, FIGURES)
    shares = "[...document.querySelectorAll('.bar i')].map((bar) => bar.offsetWidth / bar.parentNode.offsetWidth)"
    effects = json.loads((study / "summary.json").read_text())["effects"]
    expected = [share for effect in effects for share in (effect["success"], effect["error"])]
    assert browser.value(shares) == pytest.approx(expected, abs=0.02)


def pointed(browser: Browser, height: float) -> dict[str, str]:
    """Return the values by name that a plot shows under the pointer at a relative height."""
    over = "document.querySelector('#runs-0 .u-over').getBoundingClientRect()"
    x, y, width, full = (browser.value(f"{over}.{what}") for what in ("left", "top", "width", "height"))
    browser.mouse("mouseMoved", x + 0.3 * width, y + (1.0 - height) * full)
    browser.settle()
    cells = "[...document.querySelectorAll('#runs-0 .u-legend {}')].map((cell) => cell.textContent)"
    return dict(zip(*(browser.value(cells.format(part)) for part in (".u-label", ".u-value")), strict=True))


def test_pointer_shows_the_run_of_the_dot_next_to_it(study: Path, browser: Browser) -> None:
    table = pq.read_table(study / "table.parquet").to_pydict()
    browser.open(study / "report.html")
    browser.value("document.getElementById('runs-0').scrollIntoView()")
    errors = []
    for height in (0.05, 0.7):
        seen = pointed(browser, height)
        run = int(seen["run"])
        errors.append(table["rms.joint1"][run])
        assert float(seen["delay [s]"]) == pytest.approx(table["delay"][run], rel=1e-3)
        assert float(seen["succeeds"]) == pytest.approx(1e3 * errors[-1], rel=1e-3)
        assert table["success"][run]
    assert errors[0] < errors[1]
