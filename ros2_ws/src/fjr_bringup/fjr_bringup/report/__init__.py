# SPDX-License-Identifier: Apache-2.0
"""Reports of recorded runs as pages and files."""
