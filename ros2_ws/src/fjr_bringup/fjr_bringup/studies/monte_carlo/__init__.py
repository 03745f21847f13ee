# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`: Monte-Carlo runs in threads or a Dask cluster, kept in a store."""
