"""Ride against travel.

A larger weight on the suspension deflection reduces the travel, but makes the ride harder. Expected values over random roads
give smooth curves without long runs.
"""

import matplotlib.pyplot as plt

from models import Iso8608, parse_vehicle, read_vehicle
from sim import measure_run, run

text, road = read_vehicle("quarter_car").text, Iso8608("C", speed="72 km/h")


def point(vehicle, name):
    """Returns travel [mm] and ride [m/s2] of a controller."""
    [result] = run(vehicle, name, road, duration=1.0)
    metrics = measure_run(result, first=0).metrics
    return 1e3 * metrics["suspension_deflection_rms"].expected, metrics["sprung_acceleration_weighted"].expected


weights = (0.1, 2, 8, 16, 64)  # 1/m
designs = [parse_vehicle(text.replace("suspension_deflection = 0.1", f"suspension_deflection = {one}")) for one in weights]
points = [point(one, "II") for one in designs]
passive = point(designs[0], "passive")
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
axis.plot(*zip(*points, strict=True), "C0o-", label="by weight on the deflection [1/m]")
for weight, place in zip(weights, points, strict=True):
    axis.annotate(f"{weight:g}", place, (6, 4), textcoords="offset points")
axis.set(xlabel="rms travel [mm]", ylabel="ride [m/s²]", title="II on road class C at 72 km/h")
axis.legend(title=f"passive: {passive[0]:.1f} mm, {passive[1]:.2f} m/s²")
axis.margins(0.12)
figure.savefig("trade_off.png")
