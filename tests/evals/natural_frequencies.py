"""Textbook: the body bounces on both springs in series, and the wheel hops between them (Gillespie 1992, chapter 5)."""

import numpy as np

from tests.evals import Answer, Case, car, equations

MS, MU, KS, CS, KT = 310.0, 36.0, 19e3, 1100.0, 185e3
RIDE_RATE = KS * KT / (KS + KT)
POLES = sorted(np.linalg.eigvals(equations(MS, MU, KS, CS, KT)[0]), key=abs)
UNDAMPED = sorted(np.abs(np.linalg.eigvals(equations(MS, MU, KS, 0.0, KT)[0])))
assert abs(UNDAMPED[0] / np.sqrt(RIDE_RATE / MS) - 1) < 0.02  # the textbook's rules hold for such a car
assert abs(UNDAMPED[-1] / np.sqrt((KS + KT) / MU) - 1) < 0.02

CASES = [
    Case(
        "At which frequencies do the body and the wheel oscillate?",
        "synth --vehicle car.toml --controller passive",
        [
            *(
                Answer(f"controllers.0.poles.{i}.0", pole.real, 1e-9, "eigenvalues")
                for i, pole in enumerate(sorted(POLES, key=np.real))
            ),
        ],
        {"car.toml": car(MS, MU, KT, ks=KS, cs=CS)},
    )
]
