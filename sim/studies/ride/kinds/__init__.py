"""The metrics: those of the standards, and one file for each other one."""
