# SPDX-License-Identifier: Apache-2.0
"""The commands on a running loop and its bags."""
