"""What is true of a loop, in numpy and integers, without a solver: stability, norms, proofs, lower bounds, sampled data."""
