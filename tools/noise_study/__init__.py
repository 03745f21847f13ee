# SPDX-License-Identifier: Apache-2.0
"""Why the gains of arm7 decide how much noise it tolerates: the table of docs/tables/compare.md."""
