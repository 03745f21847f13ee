# SPDX-License-Identifier: Apache-2.0
"""Record and read rosbag2 bags."""
