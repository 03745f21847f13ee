# SPDX-License-Identifier: Apache-2.0
"""Discover other nodes quickly, with a DDS profile of the package fjr_bringup."""

from __future__ import annotations

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from fjr_core.errors import FjrError
from fjr_msgs_py.node.environment import domain_fault, ensure_log_folder


def discover_quickly() -> None:
    """Use a DDS profile with quick discovery unless the user set another; set the folder of the ROS 2 logs.

    Raises FjrError for an invalid ROS_DOMAIN_ID.
    """
    if fault := domain_fault():
        raise FjrError(fault)
    ensure_log_folder()
    profile = Path(get_package_share_directory("fjr_bringup"), "config", "fastdds.xml")
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
