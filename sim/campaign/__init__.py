"""Simulation of all combinations that a campaign file describes, on all cores or on a cluster, with one Parquet file as the
result.

Start with `command`, which runs the steps in order. `file` and `samples` read the campaign file. `plan` numbers the runs, and
`batch` simulates them. `store` saves the results, and `manifest` saves the gains. `summary` and `best` evaluate the results.
"""

HERE = "local"  # value of the address that starts Ray on the cores of this machine
MOST_RUNS = 10_000_000
