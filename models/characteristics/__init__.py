"""Measured characteristics: forces over velocity and deflection, motion ratios over travel, and their tables in files."""

STOP_KEYS = ("suspension_stroke", "stop_stiffness")  # keys of bump stops
STOP = "stop"  # other name of `stop_stiffness`, for tables and files
STOP_NAMES = (*STOP_KEYS, STOP)
RATIO = "ratio"  # heading of the column with a motion ratio over travel
LEAVES = 0.1  # a characteristic leaves its linearisation at this deviation, relative to its largest force
SIDES = ("bump", "rebound")  # sides of bump stops: compression and extension of the suspension
