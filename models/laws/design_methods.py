"""The methods of design, by name: the function of each, in a file of its own."""

METHODS = {
    "two_steps": "synth.design.two_step:two_steps",
    "state": "synth.design.two_step:state",
    "zero_l": "synth.design.two_step:zero_l",
    "descent": "synth.design.fallback:descent",
    "refinement": "synth.design.fallback:refinement",
    "structured": "synth.design.fixed_order.fixed_order:structured",
    "riccati": "synth.design.full_order.full_order:riccati",
    "goals": "synth.design.multi_objective.design:for_goals",
    "sampled": "synth.design.sampled_data:sampled",
    "mu": "synth.design.uncertainty.robust_design:mu",
    "lqr": "synth.design.full_order.quadratic:quadratic",
    "lqg": "synth.design.full_order.quadratic:quadratic",
    "h2": "synth.design.full_order.quadratic:quadratic",
    "preview": "synth.design.full_order.preview:preview",
}
PREVIEW = "preview"  # of the state and of the road ahead
OF_STATE = ("lqr", PREVIEW)  # of the full state, without sensors
# Methods that other keys of a section lead to; `design = "NAME"` names one of the others.
BY_OTHER_KEYS = ("two_steps", "state", "zero_l", "descent", "refinement", "structured", "riccati", "goals", "sampled", "mu")
DESIGNS = tuple(name for name in METHODS if name not in BY_OTHER_KEYS)
