"""A full-order controller with the sensors of a car.

The static gain II needs the body velocity, which no sensor of a car measures. A controller with states reaches a
smaller norm with a travel sensor and an accelerometer.
"""

import matplotlib.pyplot as plt
import numpy as np

from models import parse_vehicle, read_vehicle
from synth import closed_loop, design_controllers

section = """
[controllers.full]
measured = ["suspension_deflection", "sprung_acceleration", "control_force"]
order = "full"
"""
vehicle = parse_vehicle(read_vehicle("quarter_car").text + section)
frequencies = np.geomspace(0.1, 30, 400)  # Hz
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
for controller, style in zip(design_controllers(vehicle, ["passive", "II", "full"]), ("C7--", "C1-", "C0-"), strict=True):
    loop = closed_loop(vehicle, controller)
    gains = abs(loop["sprung_acceleration", :](2j * np.pi * frequencies)).ravel()
    axis.loglog(frequencies, gains, style, label=f"{controller.name}: norm {controller.certificate.norm.value:.3f}")
axis.set(xlabel="frequency [Hz]", ylabel="acceleration / road velocity [1/s]", title="Body acceleration of the closed loop")
axis.legend()
figure.savefig("full_order.png")
