# SPDX-License-Identifier: Apache-2.0
"""Control laws: v-dPBC, its robust additions, the laws it is compared with, and how each is called."""
