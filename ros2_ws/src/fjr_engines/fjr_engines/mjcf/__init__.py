# SPDX-License-Identifier: Apache-2.0
"""Robots in MuJoCo's format."""

from fjr_core.errors import MissingPackageError

try:
    import mujoco  # noqa: F401
except ModuleNotFoundError as missing:
    raise MissingPackageError(f"{missing.name} is not installed; expected it from: pip install mujoco") from None
