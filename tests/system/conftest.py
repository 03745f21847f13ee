# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests with pages and clusters: one real browser for the tests of a file, a real Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from system.browser import Browser


@pytest.fixture(scope="module")
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
