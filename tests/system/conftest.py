# SPDX-License-Identifier: Apache-2.0
"""Fixtures: the started programs of a test, one real browser for a process, a real Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from isolation import without_proofs
from system.browser import Browser
from system.executables import PROGRAMS, Executable, Start


@pytest.fixture
def start() -> Iterator[Start]:
    started: list[Executable] = []

    def starter(program: str, *arguments: str) -> Executable:
        started.append(Executable(*PROGRAMS[program], *arguments))
        return started[-1]

    yield starter
    for executable in started:
        executable.kill()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    made = Browser()
    yield made
    made.close()


@pytest.fixture(scope="module")
def browser(chromium: Browser) -> Iterator[Browser]:
    yield chromium
    chromium.open("about:blank")  # which needs no processor time


@pytest.fixture
def local_cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as made:
        yield made


@pytest.fixture
def no_kept_proof(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Use a cache of compiled code without the proofs that other tests and earlier runs keep."""
    with without_proofs(tmp_path_factory.mktemp("cache")) as cache:
        monkeypatch.setenv("XDG_CACHE_HOME", cache)
        yield
