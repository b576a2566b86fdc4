"""How much the loop bears: predicted, then confirmed in MuJoCo on both sides of that."""

TIMESTEP = 5e-4  # s, of its runs, unless another is asked for
