# SPDX-License-Identifier: Apache-2.0
"""The certificate of a run, and the thresholds and axes with which it is judged."""
