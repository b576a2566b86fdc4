"""A vehicle file: its parameters, controllers, goals, weights, limits and its computer; and the MuJoCo model of it."""

GOAL_KEYS = ("minimise", "bounds", "tolerance", "family", "structure")  # of a controller's section that has some
