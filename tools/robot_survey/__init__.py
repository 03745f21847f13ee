# SPDX-License-Identifier: Apache-2.0
"""Try `fjr new`, `fjr check` and `fjr run` on the URDFs of public robots."""
