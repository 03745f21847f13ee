# SPDX-License-Identifier: Apache-2.0
"""Reading files of bounded size, and folders that only this user can write."""
