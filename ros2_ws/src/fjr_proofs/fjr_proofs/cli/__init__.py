# SPDX-License-Identifier: Apache-2.0
"""What `fjr check` and `fjr gains` prove."""
