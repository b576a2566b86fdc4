"""An inerter beside the damper.

An inerter resists the relative acceleration of body and wheel. On a stiff suspension, it improves the ride, but worsens the
road holding.
"""

import matplotlib.pyplot as plt

from models import Iso8608, parse_vehicle, read_vehicle
from sim import measure_run, run

text, road = read_vehicle("quarter_car").text, Iso8608("B", speed="72 km/h")
inertances = (0.1, 10, 20, 30, 40, 60)  # kg
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
points = []
for inertance in inertances:
    vehicle = parse_vehicle(text + f'[parts.inerter]\nkind = "inerter"\ninertance = {inertance}\n')
    stiff = vehicle.with_parameters(suspension_stiffness="100 N/mm", suspension_damping="2500 N s/m")
    [result] = run(stiff, "passive", road, duration=0.5)
    metrics = measure_run(result, first=0).metrics  # expected values over the random road need no long run
    points.append((100 * metrics["dynamic_load"].expected, metrics["sprung_acceleration_weighted"].expected))
axis.plot(*zip(*points, strict=True), "C0o-")
for inertance, place in zip(inertances, points, strict=True):
    axis.annotate(f"{inertance:g} kg", place, (6, 4), textcoords="offset points")
axis.set(xlabel="dynamic tyre load [% of static]", ylabel="ride [m/s²]", title="Inerter in a stiff suspension, road class B")
axis.margins(0.15)
figure.savefig("inerter.png")
