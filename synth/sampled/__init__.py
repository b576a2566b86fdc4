"""Loops that a computer closes: any linear plant, its road continuous, its force held from sample to sample."""
