"""Sixteen loads of one car.

The paper's controller `II` is simulated with sixteen random body masses.
"""

import matplotlib.pyplot as plt
import numpy as np

from models import Iso8608, read_vehicle
from sim import measure_run, run

nominal = read_vehicle("quarter_car")
masses = np.random.default_rng(0).uniform(400, 700, size=16)  # kg
road = Iso8608("C", speed="72 km/h")
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
for name, style in (("passive", "C7o"), ("II_printed", "C0s")):
    rides = []
    for mass in masses:
        [result] = run(nominal.with_parameters(sprung_mass=mass), name, road, duration=4.0)
        rides.append(measure_run(result, first=1000).metrics["sprung_acceleration_weighted"].mujoco)
    axis.plot(masses, rides, style, label=f"{name}: {min(rides):.2f} to {max(rides):.2f} m/s²")
axis.set(xlabel="body mass [kg]", ylabel="ride, weighted acceleration [m/s²]", title="Sixteen loads, road class C at 72 km/h")
axis.legend()
figure.savefig("campaign.png")
