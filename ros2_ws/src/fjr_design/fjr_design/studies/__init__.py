# SPDX-License-Identifier: Apache-2.0
"""Studies of many simulated runs: `fjr sweep`, `fjr tune` and `fjr compare`.

sections                                        keys of a file, and what they may hold
sweep, tune, suite                              what is to run, as plain values
study                                           jobs, and a folder of their results that can be resumed
coordinates, trial                              a point of a search as gains; levels of imperfections as draws, margins
sweep_run, tune_run, compare_run                the commands: plan, run what is missing, write
sensitivity, compare_results, compare_page      what the results say, as numbers, tables and pages
"""
