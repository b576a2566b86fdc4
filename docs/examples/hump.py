"""Speed over a hump.

How fast may the car drive over a speed hump of 75 mm? The peak acceleration of the body shows the limit.
"""

import matplotlib.pyplot as plt

from models import WattsHump, read_vehicle
from sim import run
from synth import design_controllers

vehicle = read_vehicle("quarter_car")
speeds = (10, 15, 20, 30, 40)  # km/h
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
for controller, style in zip(design_controllers(vehicle, ["passive", "II"]), ("C7o-", "C0s-"), strict=True):
    peaks = []
    for speed in speeds:
        [result] = run(vehicle, controller, WattsHump(height="75 mm", speed=f"{speed} km/h"), duration=1.5)
        peaks.append(result.physics.peak("sprung_acceleration"))
    axis.plot(speeds, peaks, style, label=f"{controller.name}: at most {max(peaks):.1f} m/s²")
axis.set(xlabel="speed [km/h]", ylabel="peak body acceleration [m/s²]", title="Speed hump, 75 mm high", ylim=(0, 4))
axis.legend()
figure.savefig("hump.png")
