# SPDX-License-Identifier: Apache-2.0
"""Thresholds of the diagnosis, offline and online; tuned on other seeds than the labelled set (docs/diagnosis.md)."""

BLOCK = 20
"""Intervals that are judged together: noise averages out, a mismatch does not."""
SHARE = 0.035
"""Share of violated blocks from which on the run does not hold, if they are FEWEST at least."""
FEWEST = 3
"""Blocks needed for a verdict; violated blocks below which only their share counts."""
SHARE_OF_FEW = 0.1
"""Share of fewer violated blocks than FEWEST, up to which the run may still hold."""
HIGH_SHARE = 0.3
"""Share of violated blocks from which on their number does not matter."""
EXCEEDED = 10.0
"""Growth of V, over its lowest value and its floor, above which the run does not hold."""
DIVERGED = 100.0
"""The same growth, above which the run is violated however small the errors are."""
TOLERANCE = 1e-3
"""Tracking error [rad, m] that the causes of a violation may make in a run that is degraded, not violated."""
RELATIVE = 0.1
"""Share of the loop's own tracking error that they may make in addition."""
CAUSE_SHARE = 0.2
"""Share of the violated blocks that a cause must have fed most, to be named."""
SIGNIFICANT = 2.0
"""Standard deviations of the mean residual's supply that count as noise."""
PREDICTED = 1.3
"""Supply of the causes over that of hold and noise, above which a block is violated."""
SAME_EFFORT = 1e-6
"""Relative difference up to which the effort sent is the law's."""
AT_LIMIT = 0.999
"""Share of its limit from which on an effort is at it."""
CLIPPED_BY = 0.01
"""Share by which an effort sent exceeds what acted, where the motor is at its limit."""
CLIPPED_LEVEL = 1e-3
"""Relative width of the level that a motor at its limit gives."""
CLIPPED_FOR = 5
"""Intervals at that level in a row that make it a limit."""
EXPLAINED = 0.5
"""Share of the motors' residual that an age of the effort must explain, to be believed."""
EXACT = 0.01
"""Share of the motors' residual that the measured torque may leave, to be believed whatever another age leaves."""
HALF_WAY = 0.3
"""The same of a torque that changed within the interval, both ends being measured."""
NO_WORSE = 1.1
"""Residual that the measured torque leaves, over that of the best age, up to which it is believed instead."""
OLDEST = 6
"""Samples of age that are looked for."""
SAME_OLDER = 0.1
"""Distance of the measured torque from an older effort, over that from the newest, up to which it is that one."""
MIXED = 0.02
"""Changes of what the motors' equation needs beside one effort, over those of the efforts, above which two acted."""
NEGLIGIBLE = 1e-8
"""Changes beside the efforts, over those of the efforts, that are rounding."""
LATE = 0.5
"""Samples of age of most efforts from which on it is a delay, below which older ones are lost ones."""
GAP = 1.85
"""Sample periods from which on an interval is a gap."""
LONGEST_GAP = 20.0
"""Sample periods above which an interval says nothing."""
JUDGED = 0.2
"""Share of the intervals that must be the law's, for a verdict."""
FALLEN = 0.01
"""Largest V of the last third of a run over that of the first, below which an unstable linear loop is not blamed."""
REGULAR = 0.1
"""Relative difference from the usual length up to which an interval of a loop in real time tells the effort's age."""
UNSURE = 0.35
"""Part of an interval by which it is not known when an answer took over whose sending is stamped."""
