# SPDX-License-Identifier: Apache-2.0
"""Version of all packages of this project; setup.py reads it, and a test compares each package.xml with it."""

__version__ = "0.1.0"
