# SPDX-License-Identifier: Apache-2.0
"""`fjr tune`: search of gains in threads or on a Dask cluster, stored on disk."""
