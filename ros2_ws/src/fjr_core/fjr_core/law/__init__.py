# SPDX-License-Identifier: Apache-2.0
"""Control laws: v-dPBC, its robust extensions, and the interfaces through which they are called."""
