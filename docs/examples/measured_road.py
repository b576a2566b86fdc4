"""A measured road.

Drive over a surveyed road profile, here a sunken slab.
"""

import matplotlib.pyplot as plt
import numpy as np

from models import Profile, read_vehicle
from sim import run

distance = np.arange(0.0, 44.0, 2.0)  # m
heights = np.zeros(22)  # m
heights[2:6] = -0.045, -0.060, -0.055, -0.020
road = Profile(distance, np.column_stack([heights, heights]), speed="70 km/h", join="smooth")
vehicle = read_vehicle("quarter_car")
results = run(vehicle, ["passive", "II"], road, duration=2.0)
figure, (above, below) = plt.subplots(2, figsize=(6, 4.4), layout="constrained", sharex=True)
time = results[0].physics.time
above.plot(time, 1e3 * results[0].physics["road_displacement"], "k", label="road")
for result, style in zip(results, ("C7--", "C0-"), strict=True):
    name, physics = result.controller.name, result.physics
    above.plot(
        time, 1e3 * physics["suspension_deflection"], style, label=f"{name}: {1e3 * physics.peak('suspension_deflection'):.0f} mm"
    )
    below.plot(time, physics["sprung_acceleration"], style, label=f"{name}: {physics.peak('sprung_acceleration'):.1f} m/s²")
above.set(ylabel="travel [mm]", title="Sunken slab of 60 mm at 70 km/h: peaks")
below.set(xlabel="time [s]", ylabel="acceleration [m/s²]")
above.legend(fontsize="small")
below.legend(fontsize="small")
figure.savefig("measured_road.png")
