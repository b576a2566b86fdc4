"""The metrics of `sim/studies/ride/registry.py`: those of the standards, and one file for each other one."""
