"""A dynamometer's own log: time stamps, volts, newtons and millimetres of a damper that swings at 1.5 Hz."""

import numpy as np

from tests.evals import Answer, Case, car, equations

T = np.arange(0, 2, 1 / 300)
X, C = 0.018 * np.sin(2 * np.pi * 1.5 * T), 1500.0  # m, N s/m
V = 2 * np.pi * 1.5 * 0.018 * np.cos(2 * np.pi * 1.5 * T)
LOG = "Timestamp,Force (V),Force (N),Displacement (V),Displacement (mm)\n" + "".join(
    f"2026-03-02 10:15:{t:09.6f},{f / 200:.6f},{f:.3f},{x / 20 + 3:.6f},{x:.4f}\n"
    for t, f, x in zip(T, C * V, 1e3 * X, strict=True)
)
MS, MU, KS, KT = 250.0, 30.0, 24e3, 160e3
OMEGA = np.geomspace(0.5, 500, 20001)
A, B = equations(MS, MU, KS, C, KT)
NORM = np.abs(np.linalg.solve(1j * OMEGA[:, None, None] * np.eye(4) - A, B[:, None])[:, 1, 0]).max()

CASES = [
    Case(
        "Is this log the damper of my car as it is?",
        "synth --vehicle car.toml --controller passive",
        [Answer("controllers.0.norm", NORM, 0.02, "the damping from which the log was made")],
        {"car.toml": car(MS, MU, KT, ks=KS, more='[curves]\nsuspension_damping = { file = "log.csv" }\n'), "log.csv": LOG},
    )
]
