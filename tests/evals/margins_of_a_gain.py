"""A hand-tuned gain: how far may it rise, and how near is the loop to instability?"""

import numpy as np
from scipy.optimize import root_scalar

from tests.evals import Answer, Case, car, equations

MS, MU, KS, CS, KT = 450.0, 55.0, 21e3, 700.0, 215e3
GAINS = np.array([15000.0, -1500.0])  # on the suspension deflection [N/m] and the body's velocity [N s/m]
MEASURED = np.array([[1.0, 0, -1, 0], [0, 1, 0, 0]])
A, _ = equations(MS, MU, KS, CS, KT)
PUSH = np.array([0, 1 / MS, 0, -1 / MU])  # of a force that lifts the body


def growth(factor: float) -> float:
    """Returns the largest real part of the poles [1/s] of the loop with gains that are multiplied by a factor."""
    return np.linalg.eigvals(A + factor * np.outer(PUSH, GAINS @ MEASURED)).real.max()


FACTOR = root_scalar(growth, bracket=(1.0, 10.0), xtol=1e-12).root
OMEGA = np.geomspace(0.01, 1e4, 20001)
L = -(np.linalg.solve(1j * OMEGA[:, None, None] * np.eye(4) - A, PUSH[:, None])[..., 0] @ MEASURED.T @ GAINS)
DISK = 1 / np.abs((1 - L) / (1 + L) / 2).max()

OWN = f'[controllers.mine]\nmeasured = ["suspension_deflection", "sprung_velocity"]\ngain = [{GAINS.tolist()}]\n'
CASES = [
    Case(
        "How far may this gain rise?",
        "synth --vehicle car.toml --controller mine",
        [
            Answer("controllers.0.margins.gain_margin", FACTOR, 1e-6, "the factor at which a pole reaches the imaginary axis"),
            Answer("controllers.0.margins.disk_margin", DISK, 1e-4, "peak of (1 - L) / (1 + L) over a grid (Seiler 2020)"),
        ],
        {"car.toml": car(MS, MU, KT, ks=KS, cs=CS, more=OWN)},
    )
]
