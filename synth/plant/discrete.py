"""Discrete plants: the bilinear map to a continuous plant with the same norms, and accurate frequency responses.

Tustin's map s = (2 / dt) (z - 1) / (z + 1) maps the unit circle to the imaginary axis, and the inside of this circle to the
left half plane. A discrete loop and the continuous image of this loop therefore have the same stability and norm. A matrix X
that satisfies the bounded-real LMI (20) for the loop also satisfies (20) for the image, up to a factor dt. The measurements of
the image contain inputs and disturbances: y = C_y x + Dyw w + Dyu u. The gain stays the same, but the loop of the gain and the
image contains an algebraic loop.

A pole at z = -1 has no finite image. If the plant has a pole at z = -1, a gain K0 that moves this pole is applied first. The
plant with the gain K0 is then mapped to its image. A gain K of the plant corresponds to the gain K - K0 of the image.

The frequency response Dw + C (z - A)^-1 Bw of a discrete loop is computed with twice the digits of floats. The frequency is
given by the float t = tan(omega dt / 2). The point z = (1 + j t) / (1 - j t) is then exactly on the unit circle, without the
rounding error of a sine. Multiplied by 1 - j t, the equation for the states x is ((I - A) + j t (I + A)) x = (1 - j t) Bw. For
t > 1, this equation is divided by j t.
"""

from dataclasses import replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from synth.plant.double_double import exact_product, exact_sum
from synth.plant.generalized import Plant
from synth.plant.iterative_refinement import solve_closely, with_imaginary

# Smallest allowed singular value of the balanced A + I, relative to the largest singular value. This limits the number of
# digits that are lost
LEAST_SINGULAR_VALUE = 1e-6
MOVES = 20  # number of gains that are tried if A has a pole close to z = -1
SEED = 20261122


def continuous_image(plant: Plant) -> tuple[Plant, Array]:
    """Returns the continuous image of a discrete plant, including its measurements, and the gain K0. A continuous plant is
    returned unchanged.

    A gain K of the discrete plant, shape (m, q), corresponds to the gain K - K0 of the continuous image.

    Raises:
        InputError: the plant has a pole at z = -1, and no gain from the measurements moves this pole.
    """
    m, r, q = plant.B.shape[1], plant.Bw.shape[1], len(plant.Cy)
    if plant.dt is None:
        return plant, np.zeros((m, q))
    K0, noise = _away_from_minus_one(plant), plant.Dyw
    loop = plant.closed_loop(K0 @ plant.Cy)
    through = K0 @ noise
    inputs = np.hstack([plant.Bw + plant.B @ through, plant.B])
    direct = np.block([[plant.Dw + plant.D @ through, plant.D], [noise, np.zeros((q, m))]])
    outputs = np.vstack([loop.C, plant.Cy])
    A, B, C, D = _tustin((loop.A - np.eye(len(loop.A))) / plant.dt, inputs / plant.dt, outputs, direct, plant.dt)
    d = len(plant.C)
    Dyu = D[d:, r:] + plant.Dyu if np.any(plant.Dyu) else D[d:, r:]
    return Plant(A, B[:, r:], B[:, :r], C[:d], D[:d, r:], D[:d, :r], Cy=C[d:], Dyu=Dyu, Dyw=D[d:, :r]), K0


def continuous_loop(loop: Plant, turned: bool = False) -> Plant:
    """Returns the continuous image of a discrete loop from w to z. A continuous loop is returned unchanged.

    Args:
        loop: loop in continuous time, or in discrete time without a pole at z = -1.
        turned: True to replace the variable z by -z before the loop is mapped. With -z instead of z, the point z = -1 is mapped
            to 0 instead of infinity. The replacement changes neither the norm nor the matrix X of (20).
    """
    if loop.dt is None:
        return loop
    return from_differences((replace(loop, A=-loop.A, Bw=-loop.Bw) if turned else loop).differences, loop.dt)


def from_differences(loop: Plant, step: float) -> Plant:
    """Returns the continuous image of a loop that is written in differences (`Plant.differences`) over a step [s].

    The loop and its image have the same matrix X of (20). If the step is 0, the loop is returned unchanged.
    """
    if not step:
        return loop
    A, Bw, C, Dw = _tustin(loop.A, loop.Bw, loop.C, loop.Dw, step)
    return Plant.without_inputs(A, Bw, C, Dw)


def true_frequency(omega: float, dt: float | None) -> float:
    """Converts a frequency omega [rad/s] of the continuous image, which may be infinite, to the frequency of the discrete
    plant.
    """
    return omega if dt is None else float(2 / dt * np.arctan(omega * dt / 2))


def mapped_frequency(omega: float, dt: float | None) -> float:
    """Converts a frequency omega [rad/s] of the discrete plant to the frequency of its continuous image; the inverse of
    `true_frequency`.
    """
    if dt is None:
        return omega
    return float(2 / dt * np.tan(omega * dt / 2)) if omega * dt < np.pi else np.inf


def _tustin(A: Array, B: Array, C: Array, D: Array, step: float) -> tuple[Array, Array, Array, Array]:
    """Returns the bilinear image of a system that is written in differences over a step [s]."""
    beside = np.linalg.inv(2 * np.eye(len(A)) + step * A)
    inputs = beside @ B
    return 2 * A @ beside, 2 * inputs, 2 * C @ beside, D - step * C @ inputs


def _away_from_minus_one(plant: Plant) -> Array:
    """Returns a gain K0 for which the loop has no pole near z = -1, shape (m, q). K0 is zero if the plant has no such pole.

    K0 does not depend on the units of states, inputs or measurements. K0 depends on the units in one case only: if a pole is
    almost exactly at the limit LEAST_SINGULAR_VALUE, the powers of two from balancing matter. If the plant is given in
    coordinates that mix its states, K0 may also differ.
    """

    def lost(K: Array) -> float:
        balanced = linalg.matrix_balance(plant.A + plant.B @ K @ plant.Cy, permute=False)[0] if len(plant.A) else plant.A
        sizes = np.linalg.svd(balanced + np.eye(len(plant.A)), compute_uv=False)
        return float(sizes[-1] / max(1.0, sizes[0])) if len(sizes) else 1.0

    nothing = np.zeros((plant.B.shape[1], len(plant.Cy)))
    if lost(nothing) > LEAST_SINGULAR_VALUE:
        return nothing
    generator = np.random.default_rng(SEED)
    scale = 0.5 / _reach(plant).T
    best = max((scale * generator.standard_normal(nothing.shape) for _ in range(MOVES)), key=lost)
    if lost(best) <= LEAST_SINGULAR_VALUE:
        raise InputError(
            "the plant has a pole at z = -1 that no feedback of the measured signals moves; remove this pole, or add an actuator "
            "that acts on the mode of this pole, or a measurement that contains this mode"
        )
    return best


def _reach(plant: Plant) -> Array:
    """Returns, entry by entry, |C_y| |A|^k |B| for the smallest k at which the entry is not 0, shape (q, m); 1 if the entry is
    0 for all k.

    An entry of the result is the size of the first effect of an input on a measurement. The size of this effect does not depend
    on the units of the states.
    """
    spread, reach = np.abs(plant.B), np.zeros((len(plant.Cy), plant.B.shape[1]))
    for _ in range(len(plant.A)):
        reach = np.where(reach > 0, reach, np.abs(plant.Cy) @ spread)
        spread = np.abs(plant.A) @ spread
    return np.where(reach > 0, reach, 1.0)


def response_closely(system: Plant, t: float) -> tuple[Array, float]:
    """Returns the frequency response T at a point of the unit circle with twice the digits, and an estimate of its error.

    Args:
        system: system in discrete time, including its low-order digits `beyond`.
        t: value of tan(omega dt / 2), from 0 to infinity.

    Returns:
        The frequency response T, complex, shape (d, r), and the largest change of an entry in the last iteration.

    Raises:
        LinAlgError: the system has a pole at the point of the unit circle, up to rounding.
    """
    n = len(system.A)
    beyond = np.zeros((n + len(system.C), n)) if system.beyond is None else system.beyond
    A, eye = system.A, np.eye(n)
    minus, plus = exact_sum(eye, -A), exact_sum(eye, A)
    minus, plus = (minus[0], minus[1] - beyond[:n]), (plus[0], plus[1] + beyond[:n])
    if t <= 1:
        across = exact_product(np.full((n, n), t), plus[0])
        real, turned = minus, (across[0], across[1] + t * plus[1])
        right = np.vstack([system.Bw, -t * system.Bw])
    else:
        across = exact_product(np.full((n, n), 1 / t), minus[0])
        real, turned = plus, (-across[0], -across[1] - minus[1] / t)
        right = np.vstack([-system.Bw, -system.Bw / t])
    high, low = map(with_imaginary, real, turned)
    T, moved = solve_closely(high, low, right, system.C, beyond[n:])
    return T + system.Dw, float(moved)
