"""The methods of design, by name: the function of each, in a file of its own."""

from models.common.extensions import METHODS

PREVIEW = "preview"  # of the state and of the road ahead
OF_STATE = ("lqr", PREVIEW)  # of the full state, without sensors
# Methods that other keys of a section lead to; `design = "NAME"` names one of the others.
BY_OTHER_KEYS = ("two_steps", "state", "zero_l", "descent", "refinement", "structured", "riccati", "goals", "sampled", "mu")
DESIGNS = tuple(name for name in METHODS if name not in BY_OTHER_KEYS)
