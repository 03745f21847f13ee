# SPDX-License-Identifier: Apache-2.0
"""What the commands of `fjr` share: declaration, options, results, progress, interruption."""
