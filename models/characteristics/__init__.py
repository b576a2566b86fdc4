"""Measured characteristics (force against velocity or deflection, motion ratio against travel), and files that contain their
tables.
"""

STOP_KEYS = ("suspension_stroke", "stop_stiffness")  # keys of bump stops in vehicle files
STOP = "stop"  # other name of the key `stop_stiffness`, which is used for tables and files
STOP_NAMES = (*STOP_KEYS, STOP)
RATIO = "ratio"  # heading of the column that gives a motion ratio as a function of travel
LEAVES = 0.1  # a characteristic counts as nonlinear above this deviation from its linearisation, relative to its largest force
SIDES = ("bump", "rebound")  # sides of bump stops: compression and extension of the suspension
