"""Stability margins of a loop: predicted, then confirmed in MuJoCo on both sides."""

TIMESTEP = 5e-4  # s, of its runs, unless another is asked for
