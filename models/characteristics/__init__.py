"""Measured characteristics: forces over velocity and deflection, motion ratios over travel, and their tables in files."""

STOP_KEYS = ("suspension_stroke", "stop_stiffness")  # keys of bump stops
STOP = "stop"  # another name of the second one, for tables and files
STOP_NAMES = (*STOP_KEYS, STOP)
RATIO = "ratio"  # column of a motion ratio over travel
LEAVES = 0.1  # deviation from its line at which a curve has left it, over its largest force
SIDES = ("bump", "rebound")  # of bump stops: the suspension squeezed, and stretched
