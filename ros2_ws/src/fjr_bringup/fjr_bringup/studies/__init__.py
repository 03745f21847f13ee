# SPDX-License-Identifier: Apache-2.0
"""Studies made of many runs, in pools of workers, with their reports."""
