"""The methods of design, by name: the function of each, in a file of its own."""

from models.common.extensions import METHODS

PREVIEW = "preview"  # of the state and of the road ahead
OF_STATE = ("lqr", PREVIEW)  # of the full state, without sensors
STATIC, FULL = "static", "full"  # values of `order` beside a number of states; a design is of the first where none is named
PI, PID = PATTERNS = "pi", "pid"  # values of `structure` that are laws of their own
GOALS = ("minimise", "bounds", "tolerance", "family", "structure")  # keys of a section's goals
# Methods that other keys of a section lead to; `design = "NAME"` names one of the others.
BY_OTHER_KEYS = ("two_steps", "state", "zero_l", "descent", "refinement", "structured", "riccati", "goals", "sampled", "mu")
DESIGNS = tuple(name for name in METHODS if name not in BY_OTHER_KEYS)
