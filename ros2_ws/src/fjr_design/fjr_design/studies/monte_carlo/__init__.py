# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: Monte-Carlo study in threads or on a Dask cluster, stored on disk."""
