"""Simulation of runs in MuJoCo: cases, drivers, the simulation loop, responses, and ends of the linear regime.

Start with `drive.py`.
"""

RUNS_AT_ONCE = 256  # largest number of runs that are simulated together; larger batches would hardly be faster
