"""Delay that the loop tolerates.

`find_margins` predicts stability margins. MuJoCo confirms each margin: a run just below it decays, and a run just above it
grows.
"""

import matplotlib.pyplot as plt

from models import read_vehicle
from sim import find_margins
from synth import design_controllers

vehicle = read_vehicle("quarter_car")
controllers = design_controllers(vehicle, ["state", "I", "II"])
figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
for row, controller in enumerate(controllers):
    found = find_margins(vehicle, controller, timestep=2e-3)[""]
    predicted, mujoco = 1e3 * found.predicted_delay, 1e3 * found.delay.stable  # ms
    axis.barh(row, predicted, color="C0", label="predicted" if row == 0 else None)
    axis.plot(mujoco, row, "kD", label="MuJoCo" if row == 0 else None)
    axis.text(
        predicted - 12,
        row,
        f"{predicted:.0f} ms, disk margin {found.predicted.disk.size:.2f}",
        ha="right",
        va="center",
        color="w",
    )
axis.set_yticks(range(3), [each.name for each in controllers])
axis.texts[-1].set(x=100, ha="left", color="k")  # beside a short bar
axis.set(xlabel="largest delay of the control force [ms]", title="Delay margin of three controllers")
axis.legend(loc="upper right")
figure.savefig("margins.png")
