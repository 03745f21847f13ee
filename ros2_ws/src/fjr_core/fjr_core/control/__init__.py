# SPDX-License-Identifier: Apache-2.0
"""Control laws: v-dPBC, its robust extensions, the baseline laws, and the interfaces through which they are called."""
