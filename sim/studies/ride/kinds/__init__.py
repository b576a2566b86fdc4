"""The metrics of `sim/studies/ride/registry.py`, a file for each group of signals."""
