"""A person sits on a seat in a car: the ride of class C is that of the person, weighted as ISO 2631-1 asks."""

import numpy as np
from scipy.integrate import trapezoid

from tests.evals import Answer, Case, car

MS, MU, KS, CS, KT = 280.0, 42.0, 22e3, 1700.0, 180e3
MP, KP, CP = 82.0, 14e3, 450.0  # person and seat
SPEED, ROUGHNESS, N0 = 20.0, 256e-6, 0.1  # m/s; m3 and 1/m of class C of ISO 8608

F = np.geomspace(0.011 * SPEED, 2.83 * SPEED, 40001)  # Hz; the waves of ISO 8608, from 91 m to 0.35 m
S = 2j * np.pi * F
K = KS + CS * S
# Heights of person, body and wheel, for a road of 1 m.
M = np.zeros((len(F), 3, 3), complex)
M[:, 0, 0], M[:, 0, 1], M[:, 1, 0] = MP * S**2 + KP + CP * S, -(KP + CP * S), -(KP + CP * S)
M[:, 1, 1], M[:, 1, 2], M[:, 2, 1] = MS * S**2 + KP + CP * S + K, -K, -K
M[:, 2, 2] = MU * S**2 + K + KT
PERSON = S**2 * np.linalg.solve(M, np.array([[0.0], [0.0], [KT]]) + 0j)[:, 0, 0]
ROAD = ROUGHNESS * (F / SPEED / N0) ** -2 / SPEED  # m2/Hz, of the height


def order_two(corner, q):
    """Returns s^2 + s w / q + w^2 over w^2 of a corner frequency [Hz]."""
    omega = 2 * np.pi * corner
    return 1 + S / (q * omega) + (S / omega) ** 2


high = (S / (2 * np.pi * 0.4)) ** 2 / order_two(0.4, 2**-0.5)
transition = (1 + S / (2 * np.pi * 12.5)) / order_two(12.5, 0.63)
WK = high / order_two(100, 2**-0.5) * transition * order_two(2.37, 0.91) / order_two(3.35, 0.91) * (2.37 / 3.35) ** 2
RIDE = np.sqrt(trapezoid(np.abs(WK * PERSON) ** 2 * ROAD, F))

CASES = [
    Case(
        "How does the person ride on a road of class C at 72 km/h?",
        f"sim.drive --vehicle car.toml --controller passive --class C --speed {SPEED} --duration 2 --no-logs",
        [
            Answer(
                "runs.0.metrics.seat_acceleration_weighted.expected",
                RIDE,
                0.01,
                "integral of the weighted spectrum, Wk of ISO 2631-1",
            )
        ],
        {"car.toml": car(MS, MU, KT, ks=KS, cs=CS, more=f"[seat]\nmass = {MP}\nstiffness = {KP}\ndamping = {CP}\n")},
    )
]
