"""Preview of the road ahead.

With a sensor for the road 0.3 s ahead, the controller acts before the wheel meets the bump.
"""

import matplotlib.pyplot as plt

from models import Bump, parse_vehicle, read_vehicle
from sim import run

sections = """
[controllers.lqr]
design = "lqr"
[controllers.ahead]
design = "preview"
preview = 0.3
"""
vehicle = parse_vehicle(read_vehicle("half_car").text + sections)
runs = run(vehicle, ["lqr", "ahead"], Bump(height="50 mm"), duration=2.0)
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
for result, style in zip(runs, ("C1--", "C0-"), strict=True):
    peak = result.physics.peak("heave_acceleration")
    axis.plot(
        result.physics.time, result.physics["heave_acceleration"], style, label=f"{result.controller.name}: {peak:.2f} m/s²"
    )
axis.set(xlabel="time [s]", ylabel="heave acceleration [m/s²]", title="Half-car, bump of 50 mm at 45 km/h: peaks")
axis.legend()
figure.savefig("preview.png")
