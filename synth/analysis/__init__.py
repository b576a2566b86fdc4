"""Analysis of a closed loop without an LMI solver: stability, norms, proofs, lower bounds and sampled-data analysis."""
