# SPDX-License-Identifier: Apache-2.0
"""Run plant_node; the script of setuptools looks the entry point up first, which takes 0.03 s."""

import sys

from fjr_plant.executable import main

sys.exit(main())
