# SPDX-License-Identifier: Apache-2.0
"""Studies of many simulated runs: `fjr sweep`, `fjr tune` and `fjr compare`."""
