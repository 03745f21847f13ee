# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Iterator

import pytest

from nodes.harness import Peer, Ros


@pytest.fixture
def ros() -> Iterator[Ros]:
    made = Ros()
    yield made
    made.close()


@pytest.fixture
def peer(ros: Ros) -> Peer:
    return Peer(ros)
