# SPDX-License-Identifier: Apache-2.0
"""Make robot and scenario files from a URDF: choose the joints, guess what a URDF lacks, propose motion and gains."""
