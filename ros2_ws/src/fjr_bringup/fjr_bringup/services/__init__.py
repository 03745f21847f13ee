# SPDX-License-Identifier: Apache-2.0
"""Call services of running nodes: any service, parameters, lifecycle transitions."""
