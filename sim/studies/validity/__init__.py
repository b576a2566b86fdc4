"""Range in which linear analysis is valid, and comparison of simulated runs with a measured log.

Start with `regime_map`, which predicts the range of validity for a grid of bumps. `regime_end` finds the bump height at which
the linear regime ends. `map_runs` contains the runs over single bumps, predicted and simulated. `measured_log` compares
simulated runs with measurements.
"""
