"""Non-linear elements of a suspension: curves of dampers and springs, adjustable dampers, bump stops."""

STOP_KEYS = ("suspension_stroke", "stop_stiffness")  # keys of bump stops
STOP = "stop"  # another name of the second one, for tables and files
STOP_NAMES = (*STOP_KEYS, STOP)

SURFACE = "surface_"  # begins the name of a surface's motor in MuJoCo, after the prefix and before the tendon
RATIO = "ratio"  # column of a motion ratio over travel
LEAVES = 0.1  # deviation from its line at which a curve has left it, over its largest force
