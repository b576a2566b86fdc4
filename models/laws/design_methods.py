"""Names of the design methods. The function of each method is in a separate file."""

from models.common.extensions import METHODS

PREVIEW = "preview"  # name of the method that uses the state and the road ahead
OF_STATE = ("lqr", PREVIEW)  # methods that use the full state instead of sensors
STATIC, FULL = "static", "full"  # values of `order` that are not a number of states
PI, PID = PATTERNS = "pi", "pid"  # values of `structure` that define a law
GOALS = ("minimise", "bounds", "tolerance", "family", "structure")  # keys of a section that define goals
# These methods are selected by other keys of a section. All other methods are selected by `design = "NAME"`.
BY_OTHER_KEYS = ("two_steps", "state", "zero_l", "descent", "refinement", "structured", "riccati", "goals", "sampled", "mu")
DESIGNS = tuple(name for name in METHODS if name not in BY_OTHER_KEYS)
