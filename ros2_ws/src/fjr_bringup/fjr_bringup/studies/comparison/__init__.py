# SPDX-License-Identifier: Apache-2.0
"""`fjr compare`: all laws on all robots, as a table and a page."""
