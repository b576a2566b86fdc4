"""Range in which linear analysis is valid, and comparison of runs with a measured log.

Start with `regime_map`, which maps the range over a grid of bumps. `regime_end` finds the bump height at which this range ends.
`map_runs` predicts and simulates runs over single bumps. `measured_log` compares runs with measurements.
"""
