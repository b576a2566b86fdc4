"""Vehicle files: parameters, controllers, goals, weights, limits and implementation; and the MuJoCo model."""

GOAL_KEYS = ("minimise", "bounds", "tolerance", "family", "structure")  # keys of goals in a controller's section
