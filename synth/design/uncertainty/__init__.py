"""Errors of readings and forces: the worst case, bounds that hold for all of them, and how much of them a law bears."""
