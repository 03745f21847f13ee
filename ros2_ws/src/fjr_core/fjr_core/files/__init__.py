# SPDX-License-Identifier: Apache-2.0
"""Files of bounded size, tables of motions, and code that is imported by its name."""
