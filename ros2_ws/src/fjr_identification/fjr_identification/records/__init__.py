# SPDX-License-Identifier: Apache-2.0
"""Read records of motion: bags, CSV and Parquet files with a mapping."""
