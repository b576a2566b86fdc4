"""Designs for the loop that a computer closes: the two steps of the discrete plant of a level, and the level that they reach."""
