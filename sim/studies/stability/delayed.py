"""Slowest mode of a loop whose forces are delayed by many samples, computed without all eigenvalues of the pending forces.

If the delay is d samples, the state of the loop contains d pending forces, which the law has computed but which do not act yet.
The map from the state at one sample to the state at the next sample has eigenvalues of almost equal magnitude. An iteration of
the map can therefore not separate the largest eigenvalue from the others. This module uses the d-th power of the map, which
leads from one state to the state after the whole delay. The eigenvalues of the d-th power are well separated, because decaying
modes have nearly vanished after the delay. A few dozen applications of the d-th power therefore suffice (Arnoldi's method;
Lehoucq, Sorensen, Yang 1998, ARPACK Users' Guide).
"""

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigs

from models.common.arrays import Array
from synth.plant.state_space import StateSpace

FEW = 60  # with at most this many states and pending forces, computing all eigenvalues is faster
LARGEST = 4  # number of eigenvalues to compute: two pairs, because two loops of a symmetric vehicle can be equal


def slowest_from_sample_to_sample(cut: StateSpace, delay: int) -> complex:
    """Returns z^d, where z is the largest eigenvalue of x[k+1] = A x[k] + B C x[k-d]; z itself if d = 0.

    Args:
        cut: loop that is cut at its forces, with matrices A, B and C.
        delay: delay d in samples.
    """
    return _slowest_over_delay(cut, delay) if delay else _largest(np.linalg.eigvals(cut.loop_matrix(1.0)))


def mode(cut: StateSpace, delay: int, over_delay: complex) -> tuple[complex, Array]:
    """Returns the eigenvalue z with z^d = `over_delay`, and its eigenvector x, shape (n,).

    Args:
        cut: loop that is cut at its forces, with matrices A, B and C.
        delay: delay d in samples.
        over_delay: result of `slowest_from_sample_to_sample`.
    """
    # There are several d-th roots, where d is the delay in samples, but only one of them solves the eigenvalue equation.
    tried = over_delay ** (1 / max(delay, 1)) * np.exp(2j * np.pi * np.arange(max(delay, 1)) / max(delay, 1))
    late = cut.loop_matrix(1 / over_delay if delay else 1.0)
    sizes = np.abs(np.linalg.eigvals(late) - tried[:, None]).min(axis=1)
    z = complex(tried[int(np.argmin(sizes))])
    return z, np.linalg.svd(z * np.eye(len(late)) - late)[2][-1].conj()


def _slowest_over_delay(cut: StateSpace, delay: int) -> complex:
    """Returns the largest eigenvalue of the map from one state to the state after the whole delay."""
    Phi, Gamma, G, (n, m) = cut.A, cut.B, cut.C, cut.B.shape
    size = n + delay * m
    moved = np.empty((delay + 1, n, n))  # powers 0 to `delay` of the state matrix Phi
    moved[0] = np.eye(n)
    for k in range(delay):
        moved[k + 1] = moved[k] @ Phi
    seen = G @ moved[:-1]  # requested force per unit of the state k samples earlier, shape (delay, m, n)
    pushed = moved[-2::-1] @ Gamma  # state after the delay per unit of force in step k, shape (delay, n, m)
    length = 2 ** (2 * delay - 1).bit_length()  # smallest power of two for which the circular convolution does not wrap around
    # Requested force per unit of a force that acted k samples earlier.
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
