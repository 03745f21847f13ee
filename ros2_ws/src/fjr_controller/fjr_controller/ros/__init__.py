# SPDX-License-Identifier: Apache-2.0
"""The controller's topics: states in, efforts, certificate and diagnostics out."""
