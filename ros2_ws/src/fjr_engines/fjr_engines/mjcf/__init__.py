# SPDX-License-Identifier: Apache-2.0
"""Arms in MuJoCo's format, MJCF: specified, read and exported."""

from fjr_core.errors import PIP, MissingPackageError

try:
    import mujoco
except ModuleNotFoundError as missing:
    raise MissingPackageError(f"{missing.name} is not installed; expected it from: {PIP} mujoco") from None

mujoco.set_mju_user_warning(lambda _: None)  # else it writes MUJOCO_LOG.TXT; what it refuses is raised as well
