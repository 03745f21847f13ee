# SPDX-License-Identifier: Apache-2.0
"""While and after the arm moves: diagnosis, recording, metrics, reports and displays."""
