# SPDX-License-Identifier: Apache-2.0
"""What a recorded run holds, as arrays and metrics."""
