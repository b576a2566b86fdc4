"""Discrete plants: as continuous ones whose gains, norms and stability are the same, and how they answer at a frequency."""
