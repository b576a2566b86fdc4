"""Analysis of a closed loop with numpy and integers, without a solver: stability, norms, proofs, lower bounds, sampled data."""
