# SPDX-License-Identifier: Apache-2.0
"""Detection of exchanged joints and wrong signs in the first samples of a run."""
