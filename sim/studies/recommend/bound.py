"""Lower bound on the ride value of all controllers with the same sensors, from LQG control of the sampled loop.

Between samples, the control force u is constant. With v = [x; u] and F = [[A, B], [0, 0]], one matrix exponential therefore
gives the state after a time h, the integral of |z|^2 and, for the noise within the period, the double integral of |z|^2 (C. F.
Van Loan (1978), IEEE Transactions on Automatic Control 23, 395-404):

    exp(h [[-F', 1, 0], [0, -F', Q], [0, 0, F]]) = [[., ., M], [., ., N], [., ., Phi]],
    integral of exp(F' s) Q exp(F s) over h = Phi' N,    its integral over h = Phi' M.

The state of the discrete-time problem consists of x and of earlier forces that still act because of the delay. X is the
solution of the regulator's Riccati equation, and P is the solution of the filter's Riccati equation. P_f is the covariance of
the estimation error after a measurement, W the covariance of the noise in one period, and K the regulator's gain. The smallest
cost of a sample period is

    tr X W + tr K' (R + B' X B) K P_f + the cost of noise within the period

(K. J. Aastroem, B. Wittenmark (1997), Computer-Controlled Systems, chapter 11). No control law with the sample period and the
delay of the loop gives a smaller mean square of z.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.laws.linear import static_law
from models.vehicle.controllers import ControllerEntry
from sim.studies.recommend.optimal import weighted_vehicle
from sim.studies.recommend.task import Task
from synth.plant.generalized import Plant
from synth.plant.loop import HoldInterval

# Exponent of e for tiny weights that keep the problem regular, and smallest noise relative to a signal's rms
NEARLY_NONE, LEAST_NOISE = -9.0, 1e-6
# Exponents of e for the force weights to try, and relative change of the bound at which the search ends
FORCES, ENOUGH = np.arange(-3.0, -15.0, -1.5), 5e-3


def least_rms(plant: Plant, hold: Sequence[HoldInterval], noise: Sequence[float]) -> float:
    """Returns the smallest rms of z that any law can reach if w is white noise and C_y x + v is measured in each period.

    Args:
        plant: continuous-time plant with n states, m inputs and q measurements.
        hold: parts of the sample period, each with the delay of the force that acts during this part.
        noise: rms of the measurement noise v, which is independent from sample to sample, shape (q,).

    Raises:
        LinAlgError: a Riccati equation has no solution.
    """
    (n, m), late = plant.B.shape, max(part.delay_samples for part in hold)
    size, period = n + late * m, sum(part.duration for part in hold)
    # Each of these rows selects one entry of the vector that contains x, the forces of the last samples, and the new force.
    x, *previous = np.split(np.eye(size + m), [n + i * m for i in range(late + 1)])
    forces, cost, W, within = [previous.pop(), *previous], np.zeros((size + m, size + m)), np.zeros((n, n)), 0.0
    F, none = np.block([[plant.A, plant.B], [np.zeros((m, n + m))]]), np.zeros((n + m, n + m))
    output, Bw = np.hstack([plant.C, plant.D]), plant.Bw
    blocks = np.block([[-F.T, np.eye(n + m), none], [none, -F.T, output.T @ output], [none, none, F]])
    for part in hold:
        M, N, Phi = np.split(linalg.expm(part.duration * blocks)[:, -(n + m) :], 3)
        Q, A = Phi.T @ N, Phi[:n, :n]
        v = np.vstack([x, forces[part.delay_samples]])
        within += float(np.trace(Q[:n, :n] @ W) + np.trace(Bw.T @ (Phi.T @ M)[:n, :n] @ Bw))
        cost += v.T @ Q @ v
        noisy = linalg.expm(part.duration * np.block([[-plant.A, Bw @ Bw.T], [np.zeros((n, n)), plant.A.T]]))[:n, n:]
        x, W = Phi[:n] @ v, A @ W @ A.T + A @ noisy
    state = np.vstack([x, *forces[:late]])
    A, B, Q, S, R = state[:, :size], state[:, size:], cost[:size, :size], cost[:size, size:], cost[size:, size:]
    X = linalg.solve_discrete_are(A, B, (Q + Q.T) / 2, (R + R.T) / 2, s=S)
    inner = R + B.T @ X @ B
    K = np.linalg.solve(inner, B.T @ X @ A + S.T)[:, :n]
    Cy, V = plant.Cy, np.diag(np.square(noise))
    P = linalg.solve_discrete_are(A[:n, :n].T, Cy.T, (W + W.T) / 2, V)
    behind = P - P @ Cy.T @ np.linalg.solve(Cy @ P @ Cy.T + V, Cy @ P)
    return math.sqrt((np.trace(X[:n, :n] @ W) + np.trace(K.T @ inner @ K @ behind) + within) / period)


def lower_bound(task: Task) -> float | str:
    """Returns a lower bound on the expected ride value [m/s2] of all controllers with the same sensors, or a text if no bound
    exists.

    The weight of the control force is reduced until the ride value changes by less than `ENOUGH`. Twice the last change is then
    subtracted from the ride value. With several ride points, the bound applies to the root mean square of their ride values.
    This root mean square is at most the value at the worst point. Limits on control force and suspension stroke are ignored.
    """
    if any(wheel.behind(task.vehicle.parameters) for wheel in task.vehicle.kind.wheels):
        return "the front wheels show the road of the rear wheels in advance"
    last, change, points, how = math.inf, math.inf, task.line.ride_points.worst_of, task.line.implementation
    given = zip(task.sensors, task.given_noise(task.sensors), strict=True)
    noise = [max(one, LEAST_NOISE * task.rms[name]) / task.white for name, one in given]
    entry = ControllerEntry("bound", task.sensors, static_law(np.zeros((len(task.forces), len(noise)))))
    try:
        for force in FORCES:
            car = weighted_vehicle(task, {"travel": NEARLY_NONE, "tyre": NEARLY_NONE, "force": float(force)}, delayed=False)
            car = replace(car, implementation=replace(how, sample_period=how.sample_period or task.timestep))
            posed = FEATURES.load("norm as implemented").held_problem(car, entry)
            ride = task.white * least_rms(posed.plant, posed.pieces, noise) / math.sqrt(len(points))
            change, last = last - ride, min(ride, last)
            if change < ENOUGH * last:
                break
    except (InputError, np.linalg.LinAlgError, ValueError) as error:
        if math.isinf(change):
            return str(error)
    return last - 2 * change if 0 < last - 2 * change < math.inf else "it does not converge"
