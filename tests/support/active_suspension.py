"""MathWorks' example of an active suspension, "Robust Control of Active Suspension", in this project's terms.

A quarter car with an actuator of 60 rad/s measures its suspension deflection (noise 0.01) and the acceleration of its body (noise
0.5). z is the force asked for, weighed above 50 rad/s, and body acceleration and deflection over what they are to be at most at
each frequency, weighed against each other by one number: 0.01 for comfort, 0.99 for handling. The road is 0.07 m.
"""

import numpy as np

from synth.plant.augmented import append, gain, series, transfer_function
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace

SCENARIOS = (0.01, 0.5, 0.99)
PRINTED = {0.01: (0.94, 0.93962), 0.5: (0.67, 0.67222), 0.99: (0.89, 0.88515)}  # norms printed there, and by LMI elsewhere
BODY, WHEEL, DAMPING, SPRING, TYRE = 300.0, 60.0, 1000.0, 16000.0, 190000.0  # kg, kg, N s/m, N/m, N/m


def quarter_car() -> StateSpace:
    """From the road's height [m] and a force [kN] to suspension deflection [m] and body acceleration [m/s2]."""
    body = np.array([-SPRING, -DAMPING, SPRING, DAMPING]) / BODY
    wheel = np.array([SPRING, DAMPING, -SPRING - TYRE, -DAMPING]) / WHEEL
    A = np.array([[0, 1, 0, 0], body, [0, 0, 0, 1], wheel])
    B = np.array([[0, 0], [0, 1e3 / BODY], [0, 0], [TYRE / WHEEL, -1e3 / WHEEL]])
    return StateSpace(A, B, np.array([[1, 0, -1, 0], body]), np.array([[0, 0], [0, 1e3 / BODY]]))


def active_suspension(handling: float) -> Plant:
    """The plant of a scenario: 8 states, w = road and two noises, y = deflection and acceleration."""
    actuator = transfer_function([1], [1 / 60, 1])
    # [w; u] -> [road, force, noise, noise, u]
    asked = series(gain([[1], [1]]), append(actuator, gain(1)))
    into = series(append(gain(0.07), gain(np.eye(2)), asked), gain(np.eye(5)[[0, 3, 1, 2, 4]]))
    # -> [deflection, acceleration, noise, noise, u] -> [u, acceleration, deflection, y]
    signals = series(into, append(quarter_car(), gain(np.eye(3))))
    chosen = gain([[0, 0, 0, 0, 1], [0, 1, 0, 0, 0], [1, 0, 0, 0, 0], [1, 0, 0.01, 0, 0], [0, 1, 0, 0.5, 0]])
    weights = append(
        transfer_function([0.8, 40], [1, 500]),
        transfer_function([(1 - handling) / 150, 1 - handling], [0.4 / 0.45, 0.4]),
        transfer_function([handling / 80, handling], [0.04 / 8, 0.04]),
        gain(np.eye(2)),
    )
    whole = series(series(signals, chosen), weights)
    (Bw, B), (C, Cy), Dw = np.split(whole.B, [3], 1), np.split(whole.C, [3]), whole.D
    return Plant(whole.A, B, Bw, C, Dw[:3, 3:], Dw[:3, :3], Cy=Cy, Dyw=Dw[3:, :3])
