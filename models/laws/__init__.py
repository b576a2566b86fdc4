"""Laws of controllers: linear, semi-active, and in Python of the user's own; previews; what a controller's section asks for."""

GOAL_KEYS = ("minimise", "bounds", "tolerance", "family", "structure")  # keys of goals in a controller's section
