# SPDX-License-Identifier: Apache-2.0
"""The motion to record, from which the parameters of elastic joints are known best."""
