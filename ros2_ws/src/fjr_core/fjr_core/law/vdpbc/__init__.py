# SPDX-License-Identifier: Apache-2.0
"""The paper's method: link stage (30)-(33), motor stage (39)-(42), storage (43) and rate (50)."""
