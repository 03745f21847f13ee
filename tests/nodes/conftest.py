# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from nodes.harness import Peer, Ros


@pytest.fixture
def peer(ros: Ros) -> Peer:
    return Peer(ros)
