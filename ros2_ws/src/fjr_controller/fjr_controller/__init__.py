# SPDX-License-Identifier: Apache-2.0
"""The v-dPBC tracking controller as a ROS 2 node."""
