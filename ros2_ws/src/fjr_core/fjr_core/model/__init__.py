# SPDX-License-Identifier: Apache-2.0
"""Robot model: rigid arm, elastic joints, eq. (36), virtual system."""
