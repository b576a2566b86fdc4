"""Simulation of runs in MuJoCo: cases, drivers, the simulation loop, responses, and ends of the linear regime.

Start with `drive.py`.
"""

RUNS_AT_ONCE = 256  # number of runs that are simulated together; more runs would hardly save time
