# SPDX-License-Identifier: Apache-2.0
"""What is watched while the arm moves: the certificate V of the law, and the external torque on each joint."""
