"""Stability margins of a loop, both predicted by linear analysis and found in MuJoCo.

Start with `margin_search`, which contains `find_margins`. `edge` searches in MuJoCo for the smallest gain factor, delay or
sample period that makes a loop unstable.
"""

TIMESTEP = 5e-4  # s, timestep of the runs if the user gives none
