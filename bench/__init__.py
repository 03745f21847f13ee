# SPDX-License-Identifier: Apache-2.0
"""Benchmarks against peers in the same run, with bounds: `make bench`, docs/tables/benchmark_methods.md."""
