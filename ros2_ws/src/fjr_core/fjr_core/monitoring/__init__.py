# SPDX-License-Identifier: Apache-2.0
"""What a run shows: certificate, diagnosis of its violations, and isolation of faults."""
