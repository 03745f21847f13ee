# SPDX-License-Identifier: Apache-2.0
"""Monitoring of a run: certificate, diagnosis of violations, isolation of faults."""
