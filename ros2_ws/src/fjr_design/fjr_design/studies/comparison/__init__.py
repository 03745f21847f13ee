# SPDX-License-Identifier: Apache-2.0
"""`fjr compare`: compare control laws on several robots, as a table and an HTML page."""
