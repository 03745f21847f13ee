# SPDX-License-Identifier: Apache-2.0
"""How the plant's time passes: with the clock, or in lock-step with commands."""
