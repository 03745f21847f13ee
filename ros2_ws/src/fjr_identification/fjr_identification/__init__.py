# SPDX-License-Identifier: Apache-2.0
"""Make the model of a robot from recorded motion."""
