"""Your own car on a rough road.

Write the parameters of the vehicle with their units, and compare a designed controller with the passive car.
"""

import matplotlib.pyplot as plt

from models import Iso8608, parse_vehicle
from sim import measure_run, run

vehicle = parse_vehicle("""
type = "quarter_car"
[parameters]
sprung_mass = "410 kg"
unsprung_mass = "45 kg"
suspension_stiffness = "24 N/mm"
suspension_damping = "1400 N s/m"
tyre_stiffness = "210 N/mm"
[performance]
sprung_acceleration = 1.0
suspension_deflection = 10.0
control_force = 1e-3
[controllers.mine]
measured = ["suspension_deflection", "sprung_velocity"]
""")
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
for result, style in zip(
    run(vehicle, ["passive", "mine"], Iso8608("C", speed="72 km/h"), duration=10.0), ("C7-", "C0-"), strict=True
):
    ride = measure_run(result, first=3000).metrics["sprung_acceleration_weighted"].mujoco
    label = f"{result.controller.name}: ride {ride:.2f} m/s²"
    axis.plot(result.physics.time[3000:6000], result.physics["sprung_acceleration"][3000:6000], style, label=label)
axis.set(xlabel="time [s]", ylabel="body acceleration [m/s²]", title="Road class C at 72 km/h")
axis.legend(loc="upper center", ncols=2, fontsize="small")
axis.set_ylim(-5, 6.5)
figure.savefig("own_car.png")
