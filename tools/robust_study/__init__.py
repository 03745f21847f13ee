# SPDX-License-Identifier: Apache-2.0
"""Study of disturbance observer, integral action and Smith predictor for docs/robust.md."""
