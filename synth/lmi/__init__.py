"""Solution of the LMI problems (22) and (25): logarithmic barriers, central paths, and the solver Clarabel."""
