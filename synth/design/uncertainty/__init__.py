"""Gain errors of measurements and forces: the worst case, bounds for all errors, and the largest tolerated errors."""
