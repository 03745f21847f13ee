# SPDX-License-Identifier: Apache-2.0
"""Laws and plants that users and other packages add."""
