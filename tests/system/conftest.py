# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests with pages and clusters: one real browser for all tests of a process, a real Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from isolation import without_proofs
from system.browser import Browser


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    made = Browser()
    yield made
    made.close()


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
