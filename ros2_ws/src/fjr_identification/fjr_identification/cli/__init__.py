# SPDX-License-Identifier: Apache-2.0
"""The commands that excite and identify a robot."""
