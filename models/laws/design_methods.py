"""Names of the design methods. The function of each method is in a separate file."""

from models.common.extensions import METHODS

PREVIEW = "preview"  # name of the design method that uses the full state and the road ahead
OF_STATE = ("lqr", PREVIEW)  # design methods that use the full state instead of measured signals
STATIC, FULL = "static", "full"  # texts that the key `order` allows instead of a number of states
PI, PID = PATTERNS = "pi", "pid"  # values of the key `structure` that define a control law
GOALS = ("minimise", "bounds", "tolerance", "family", "structure")  # keys of a controller's section that define goals
# These design methods are selected by other keys of a section; all other methods are selected by `design = "NAME"`.
BY_OTHER_KEYS = ("two_steps", "state", "zero_l", "descent", "refinement", "structured", "riccati", "goals", "sampled", "mu")
DESIGNS = tuple(name for name in METHODS if name not in BY_OTHER_KEYS)
