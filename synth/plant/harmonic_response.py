"""Responses of a closed loop (`synth.plant.loop.Loop`) to sinusoidal inputs.

A force that was computed j samples ago is the new force times exp(-j s T), where s is the Laplace variable and T the sample
period. A delayed force thus needs no additional state of the loop.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from models.common.arrays import Array
from synth.plant.loop import Loop
from synth.plant.state_space import StateSpace


def _disturbances(loop: Loop, drive: Mapping[str, Array]) -> tuple[list[int], Array]:
    """Returns the columns of the disturbances in `drive` in `Loop.open_loop`, and the amplitudes of these disturbances, shape
    (F, d, c).
    """
    names = [name for name in drive if name not in loop.forces]
    return loop.open_loop.columns(names), np.stack([drive[name] for name in names], axis=1)


def _harmonic(loop: Loop, drive: Mapping[str, Array], omega: Array) -> tuple[Array, Array, Array]:
    """Returns the response of a sampled-data loop to sinusoidal inputs, evaluated at the samples.

    A delay of j samples corresponds to the factor z^-j. The states s = [x; states of the law] and the forces therefore satisfy

        z s = A s + G u + E d,    u = C s + H u + F d.

    The arguments are the same as those of `frequency_response`.

    Returns:
        The values of z, shape (F, 1, 1); the states s, shape (F, n + k, c); and the computed forces, shape (F, m, c).
    """
    system, n, m = loop.open_loop, len(loop.plant.A) + loop.law.states, len(loop.forces)
    z, (columns, d) = np.exp(1j * omega * loop.period)[:, None, None], _disturbances(loop, drive)
    rows = system.rows(loop.requested_forces)
    G, H, turned = system.B[:n, :m], system.D[rows, :m], 1.0
    for j in range(loop.stored_forces):
        turned, some = turned / z, slice(n + j * m, n + (j + 1) * m)
        G, H = G + turned * system.A[:n, some], H + turned * system.C[rows, some]
    C, outside = system.C[rows, :n], system.D[np.ix_(rows, columns)] @ d
    outside = outside + np.stack([drive.get(name, np.zeros_like(d[:, 0])) for name in loop.forces], axis=1)
    if np.any(H):
        loops = np.eye(m) - H
        C, outside = np.linalg.solve(loops, np.broadcast_to(C, (len(z), m, n))), np.linalg.solve(loops, outside)
    push = system.B[:n, columns] @ d + G @ outside.astype(complex)
    if len(loop.by_step) > 1:  # the disturbances change within the sample period
        Phi, Gamma = loop.hold_matrices(loop.step or 0.0)
        change, more, turn = Gamma[:, columns] @ d, np.zeros_like(push[:, : len(loop.plant.A)]), _turn(loop, omega)
        for i in range(1, len(loop.by_step)):
            more = Phi @ more + (turn**i - 1) * change
        push[:, : len(Phi)] += more
    states = np.linalg.solve(z * np.eye(n) - system.A[:n, :n] - G @ C, push)
    return z, states, C @ states + outside


def _turn(loop: Loop, omega: Array) -> Array:
    """Returns exp(j omega h) for a step h, shape (F, 1, 1)."""
    return np.exp(1j * omega * (loop.step or 0.0))[:, None, None]


def _by_step(
    loop: Loop, outputs: Sequence[str], drive: Mapping[str, Array], omega: Array
) -> tuple[StateSpace, list[Array], list[Array], Array]:
    """Returns the response to sinusoidal inputs in every step of the sample period, relative to exp(j omega t).

    Returns:
        The plant as a system from the forces and the disturbances in `drive` to the outputs. The states of this plant and the
        acting forces, both in each step. The amplitudes of the sinusoidal disturbances.
    """
    plant = loop.plant.part(outputs, (*loop.forces, *(name for name in drive if name not in loop.forces)))
    (z, states, forces), (columns, d) = _harmonic(loop, drive, omega), _disturbances(loop, drive)
    (Phi, Gamma), m, turn = loop.hold_matrices(loop.step or 0.0), len(loop.forces), _turn(loop, omega)
    x, steps, acting = states[:, : len(Phi)], [], []
    for i, late in enumerate(loop.by_step):
        u = forces / (turn**i * z**late)
        steps, acting = [*steps, x], [*acting, u]
        x = (Phi @ x + Gamma[:, :m] @ u + Gamma[:, columns] @ d) / turn
    return plant, steps, acting, d


def harmonic_states(loop: Loop, drive: Mapping[str, Array], omega: Array) -> Array:
    """Returns the states of `Loop.closed_loop` at the samples in response to sinusoidal inputs, shape (F, N, c).

    The arguments are the same as those of `frequency_response`.
    """
    z, states, forces = _harmonic(loop, drive, omega)
    return np.concatenate([states, *(forces / z ** (j + 1) for j in range(loop.stored_forces))], axis=1)


def frequency_response(loop: Loop, outputs: Sequence[str], drive: Mapping[str, Array], omega: Array) -> Array:
    """Returns the complex amplitudes of outputs of the plant in response to sinusoidal inputs, shape (F, p, c).

    If the sample period has several steps, held forces cause components at additional frequencies. The result then contains
    only the component at the frequency of the input.

    Args:
        loop: loop in continuous time, or sampled-data loop.
        outputs: names of p outputs of the plant.
        drive: complex amplitudes of the sinusoidal inputs, by name, each of shape (F, c). The amplitudes of disturbances refer
            to the start of a step. Amplitudes with the name of a force are added to the requested force.
        omega: angular frequencies [rad/s], shape (F,).
    """
    if not loop.stored_forces and (not loop.hold or len(loop.by_step) == 1):
        at = np.exp(1j * omega * loop.period) if loop.hold else 1j * omega
        return loop.closed_loop.part(outputs, list(drive)).driven(at, np.stack(list(drive.values()), axis=1))
    plant, x, u, d = _by_step(loop, outputs, drive, omega)
    inputs = np.concatenate([sum(u) / len(u), d], axis=1)
    return plant.C @ (sum(x) / len(x)) + plant.D @ inputs


def stepwise_response(loop: Loop, outputs: Sequence[str], drive: Mapping[str, Array], omega: Array) -> tuple[Array, Array]:
    """Returns outputs of a sampled-data loop in every step of the sample period, for the inputs exp(j omega t).

    The sample period starts at t = 0. Between samples, held forces cause components at additional frequencies, whereas
    `frequency_response` contains only the component at omega. The arguments are the same as those of `frequency_response`.

    Returns:
        The outputs, complex, shape (P + 1, F, p, c), where the last entry is the start of the next period. The jumps of the
        outputs at the times when the force of a step starts to act, complex, shape (P, F, p, c).
    """
    plant, x, u, d = _by_step(loop, outputs, drive, omega)
    turn, through = _turn(loop, omega), plant.D[:, : len(loop.forces)]
    # In units of exp(j omega t), the force during the previous sample period is also u[-1]
    before = [u[-1] / turn, *(one / turn for one in u[:-1])]
    values, jumps = [], []
    for i, (state, now, last) in enumerate(zip(x, u, before, strict=True)):
        values.append((plant.C @ state + plant.D @ np.concatenate([now, d], axis=1)) * turn**i)
        jumps.append(through @ (now - last) * turn**i)
    return np.stack([*values, values[0] * turn ** len(u)]), np.stack(jumps)
