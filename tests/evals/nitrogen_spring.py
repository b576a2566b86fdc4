"""A hydropneumatic strut: a dense table of its force has the stiffness of the gas law at rest."""

import numpy as np

from tests.evals import GRAVITY, Answer, Case, car, equations, table

MS, MU, CS, KT = 420.0, 48.0, 1800.0, 230e3
VOLUME, AREA, EXPONENT = 0.35e-3, 1.1e-3, 1.3  # m3, m2, -
X = np.linspace(-0.09, 0.09, 241)
FORCE = MS * GRAVITY * (VOLUME / (VOLUME - AREA * X)) ** EXPONENT
STIFFNESS = EXPONENT * MS * GRAVITY * AREA / VOLUME  # n p A^2 / V, with the pressure p = m g / A at rest

OMEGA = np.geomspace(0.5, 500, 20001)
A, B = equations(MS, MU, STIFFNESS, CS, KT)
X_OF_ROAD = np.linalg.solve(1j * OMEGA[:, None, None] * np.eye(4) - A, B[:, None])[..., 0]
OF_VELOCITY = np.abs(1j * OMEGA * X_OF_ROAD[:, 1] / (1j * OMEGA))  # of the body's acceleration over the road's velocity

CURVE = '[curves]\nsuspension_stiffness = { file = "gas.csv" }\n'
CASES = [
    Case(
        "How much does the body's acceleration amplify the road on this spring?",
        "synth --vehicle car.toml --controller passive",
        [Answer("controllers.0.norm", OF_VELOCITY.max(), 2e-3, "gas law, and a sweep of the quarter-car of that stiffness")],
        {"car.toml": car(MS, MU, KT, cs=CS, more=CURVE), "gas.csv": table("compression [mm],force [N]", 1e3 * X, FORCE)},
    )
]
