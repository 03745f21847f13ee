# SPDX-License-Identifier: Apache-2.0
"""The control step in C, from a measured state to the effort that is sent, and the observer of its state."""
