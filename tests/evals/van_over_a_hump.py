"""The rear corner of a van, whose damper is softer in compression, over a speed hump, at first light and then laden."""

import numpy as np
from scipy.integrate import solve_ivp

from tests.evals import GRAVITY, Answer, Case, car

MS, MU, KS, KT = 850.0, 70.0, 58e3, 310e3
REBOUND, COMPRESSION = 3600.0, 1900.0  # N s/m
HEIGHT, LENGTH, SPEED = 0.05, 3.2, 8.0  # m, m, m/s
PAYLOAD = 320.0  # kg


def peaks(ms: float) -> tuple[float, float]:
    """Returns the peaks of the suspension deflection [m] and of the body's acceleration [m/s2], by DOP853."""

    def force(x):
        return KS * (x[0] - x[2]) + np.where(x[1] > x[3], REBOUND, COMPRESSION) * (x[1] - x[3])  # pulls the body down

    def rate(t, x):
        road = HEIGHT / 2 * (1 - np.cos(2 * np.pi * SPEED * t / LENGTH)) if t < LENGTH / SPEED else 0.0
        return [x[1], -force(x) / ms, x[3], (force(x) - KT * (x[2] - road)) / MU]

    time = np.linspace(0, 3, 3001)
    x = solve_ivp(rate, (0, 3), np.zeros(4), "DOP853", time, rtol=1e-9, atol=1e-10, max_step=0.01).y
    return np.abs(x[0] - x[2]).max(), np.abs(force(x) / ms).max()


CURVE = f"[curves]\nsuspension_damping = {{ velocity = [-1, 0, 1], force = [{-COMPRESSION}, 0, {REBOUND}] }}\n"
VAN = {"van.toml": car(MS, MU, KT, ks=KS, more=CURVE)}
TRAVEL, ACCELERATION = peaks(MS)
SINKS = PAYLOAD * GRAVITY / KS
CASES = [
    Case(
        "How far does the suspension travel over the hump, and how hard is the blow?",
        f"sim.bump --vehicle van.toml --controller passive --height {HEIGHT} --length {LENGTH} --speed {SPEED} --no-logs",
        [
            Answer("runs.0.signals.suspension_deflection.peak.mujoco", TRAVEL, 1e-4, "DOP853 of both branches of the damper"),
            Answer("runs.0.signals.sprung_acceleration.peak.mujoco", ACCELERATION, 1e-3, "the same, of samples of 1 ms"),
        ],
        VAN,
    ),
    Case(
        f"How far does it sink under {PAYLOAD:g} kg?",
        f"sim.drive --vehicle van.toml --controller passive --load payload:mass={PAYLOAD}:rise=5 --duration 7 --no-logs",
        [
            Answer(
                "runs.0.metrics.suspension_deflection_peak.mujoco",
                SINKS,
                0.01,
                "m g / k; the load rises in 5 s, and hardly overshoots",
            )
        ],
        VAN,
    ),
]
