# SPDX-License-Identifier: Apache-2.0
"""Control laws: v-dPBC, its gains and rate, and the interfaces through which laws are called."""
