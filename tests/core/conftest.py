# SPDX-License-Identifier: Apache-2.0
"""Tests of fjr_core. Helpers that several of them share: cases.py, oracle.py, properties.py."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
