# SPDX-License-Identifier: Apache-2.0
"""Identify stiffness, rotor inertia, friction, inertia of the links and timing of an elastic arm from records.

`identify` is the way from records to estimates: `filtered_fit` (equations of both sides along the filtered motion),
`multiple_shooting` (likelihood of segments simulated by `shooting`), `optimise` (its maximum) and `verdicts`
(intervals, what is identified, and why not). The model is `elastic_arm`, its parameters `parameters`, a record
`motion_record`; `estimation_problem` sets up one from the other. `validation` compares predictions with records.
"""
