"""What the project promises: the paper's numbers, proofs, bounds, agreement of physics and analysis, faults that are found."""
