"""Slowest mode of a loop whose forces are delayed by many samples, without the eigenvalues of all pending forces.

Over one delay of d samples the state and the d pending forces become the later state and the forces computed meanwhile. That map
is the d-th power of the map from sample to sample, whose eigenvalues are so close in size that the largest is found only with all
the others. The eigenvalues of the power are apart: decaying motion is all but gone after a delay, so that a few dozen
applications of it suffice (Arnoldi's method; Lehoucq, Sorensen, Yang 1998, ARPACK Users' Guide).
"""

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigs

from models.common.arrays import Array
from synth.plant.state_space import StateSpace

FEW = 60  # states and pending forces; of so few all eigenvalues are quicker
LARGEST = 4  # eigenvalues that are requested: two pairs, should two loops of a symmetric vehicle be alike


def slowest_from_sample_to_sample(cut: StateSpace, delay: int) -> complex:
    """Returns the delay-th power of the largest eigenvalue z of x[k+1] = A x[k] + B C x[k-delay], and z without delay."""
    return _slowest_over_delay(cut, delay) if delay else _largest(np.linalg.eigvals(cut.loop_matrix(1.0)))


def mode(cut: StateSpace, delay: int, over_delay: complex) -> tuple[complex, Array]:
    """Returns that eigenvalue z from its power, and its vector x, shape (n,)."""
    # Over a delay it has turned by any number of whole turns; one of them solves the equation.
    tried = over_delay ** (1 / max(delay, 1)) * np.exp(2j * np.pi * np.arange(max(delay, 1)) / max(delay, 1))
    late = cut.loop_matrix(1 / over_delay if delay else 1.0)
    sizes = np.abs(np.linalg.eigvals(late) - tried[:, None]).min(axis=1)
    z = complex(tried[int(np.argmin(sizes))])
    return z, np.linalg.svd(z * np.eye(len(late)) - late)[2][-1].conj()


def _slowest_over_delay(cut: StateSpace, delay: int) -> complex:
    """Returns the largest eigenvalue of the delay-th power of the map from sample to sample."""
    Phi, Gamma, G, (n, m) = cut.A, cut.B, cut.C, cut.B.shape
    size = n + delay * m
    moved = np.empty((delay + 1, n, n))  # powers of Phi
    moved[0] = np.eye(n)
    for k in range(delay):
        moved[k + 1] = moved[k] @ Phi
    seen = G @ moved[:-1]  # the force that a state of k samples ago requests, shape (delay, m, n)
    pushed = moved[-2::-1] @ Gamma  # the last state, of the force that acts in step k, shape (delay, n, m)
    length = 2 ** (2 * delay - 1).bit_length()  # nothing runs round
    # The force that is requested, of the one that acted k samples ago.
    answered = np.fft.rfft(np.concatenate([np.zeros((1, m, m)), seen[:-1] @ Gamma]), length, axis=0)

    def after(state: Array) -> Array:
        x, forces = state[:n], state[n:].reshape(delay, m)
        requested = seen @ x + np.fft.irfft(np.matvec(answered, np.fft.rfft(forces, length, axis=0)), length, axis=0)[:delay]
        return np.concatenate([moved[-1] @ x + np.einsum("kij,kj->i", pushed, forces), requested.ravel()])

    if size <= FEW:
        poles = np.linalg.eigvals(np.stack([after(unit) for unit in np.eye(size)], axis=1))
    else:
        start = np.random.default_rng(0).standard_normal(size)
        operator = LinearOperator((size, size), matvec=after, dtype=float)  # pyright: ignore[reportCallIssue]
        poles = np.asarray(eigs(operator, LARGEST, v0=start, return_eigenvectors=False))
    return _largest(poles)


def _largest(eigenvalues: Array) -> complex:
    return complex(eigenvalues[np.argmax(np.abs(eigenvalues))])
