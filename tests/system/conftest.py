# SPDX-License-Identifier: Apache-2.0
"""Fixtures: a ROS domain for each file, the started programs of a test, a real browser, a real Dask cluster."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from itertools import cycle
from typing import Any
from unittest import mock

import pytest

from isolation import leased_domain, without_proofs
from system.browser import Browser
from system.executables import Executable, Start, installed


@pytest.fixture(scope="session")
def domains() -> Iterator[str]:
    """ROS domains to take in turn: nodes that were killed stay in the graph for 5 s, longer on a busy machine."""
    return cycle([leased_domain() for _ in range(3)])


@pytest.fixture(scope="module", autouse=True)
def another_domain(domains: Iterator[str]) -> Iterator[None]:
    """Use another ROS domain than the last file."""
    with mock.patch.dict(os.environ, ROS_DOMAIN_ID=next(domains)):
        yield


@pytest.fixture
def start() -> Iterator[Start]:
    started: list[Executable] = []

    def starter(program: str, *arguments: str) -> Executable:
        started.append(Executable(installed(program, *arguments)))
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
def no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do without Matplotlib, whose pictures take a second; the pages have every plot."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)


@pytest.fixture
def no_kept_proof(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Use a cache of compiled code without the proofs that other tests and earlier runs keep."""
    with without_proofs(tmp_path_factory.mktemp("cache")) as cache:
        monkeypatch.setenv("XDG_CACHE_HOME", cache)
        yield
