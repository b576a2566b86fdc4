"""Dry friction and hysteresis.

Seals and bushings add dry friction to the damper. The force then depends on the past motion, so force over travel is a
hysteresis loop.
"""

import matplotlib.pyplot as plt

from models import Bump, parse_vehicle, read_vehicle
from sim import run

text = read_vehicle("quarter_car").text
friction = '\n[parts.seal]\nkind = "dahl"\nforce = 150.0\nrho = 1000.0\ndamping = 0.0\n'
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
for name, vehicle in (("damper", parse_vehicle(text)), ("damper with friction", parse_vehicle(text + friction))):
    [result] = run(vehicle, "passive", Bump(height="60 mm"), duration=2.0)
    physics, c = result.physics, vehicle.parameters["suspension_damping"]
    force = c * (physics["sprung_velocity"] - physics["unsprung_velocity"])
    if "friction" in name:
        force = force + 150.0 * physics["seal_friction"]  # from -1 to 1
    label = f"{name}: peak acceleration {physics.peak('sprung_acceleration'):.2f} m/s²"
    axis.plot(1e3 * physics["suspension_deflection"], force, "C0-" if "friction" in name else "C7--", label=label)
axis.set(xlabel="travel [mm]", ylabel="damper and friction [N]", title="Bump of 60 mm at 45 km/h")
axis.legend(fontsize="small", loc="upper left")
axis.set_ylim(-500, 800)
figure.savefig("hysteresis.png")
