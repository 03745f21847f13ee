# SPDX-License-Identifier: Apache-2.0
"""The laws that v-dPBC is compared with (docs/baselines.md): each as its paper has it, some with what users add too."""
