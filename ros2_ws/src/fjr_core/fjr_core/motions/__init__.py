# SPDX-License-Identifier: Apache-2.0
"""Reference trajectories, transitions between them and their limits."""
