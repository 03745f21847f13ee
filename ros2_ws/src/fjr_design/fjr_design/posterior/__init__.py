# SPDX-License-Identifier: Apache-2.0
"""What an identification knows about a robot, and plants drawn from it."""
