"""Skyhook damping as a Python function.

A control law can be a function. This law only dissipates energy, as a semi-active damper does.
"""

import matplotlib.pyplot as plt

from models import Bump, read_vehicle
from sim import measure_run, run


def skyhook(sample, state):
    """Returns the force [N] of a damper between body and sky."""
    body, wheel = sample["sprung_velocity"], sample["unsprung_velocity"]
    return (-3000.0 * body if body * (body - wheel) > 0 else 0.0), state


figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
runs = run(read_vehicle("quarter_car"), ["passive", skyhook], Bump(height="100 mm", speed="45 km/h"))
for result, style in zip(runs, ("C7--", "C0-"), strict=True):
    ride = measure_run(result, first=0).metrics["sprung_acceleration_weighted"].mujoco
    deflection = 1e3 * result.physics["suspension_deflection"]
    axis.plot(result.physics.time, deflection, style, label=f"{result.controller.name}: ride {ride:.2f} m/s²")
axis.set(xlabel="time [s]", ylabel="suspension deflection [mm]", title="Bump of 100 mm at 45 km/h")
axis.legend()
figure.savefig("skyhook.png")
