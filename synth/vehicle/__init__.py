"""The controllers of a vehicle file: which method designs which; trade-offs, sample rates, the paper, python-control."""
