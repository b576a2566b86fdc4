"""Lower bounds on the norm from invariant points: frequencies at which some direction of z is independent of the control.

Let z = Gw w + Gu u at one frequency. No controller, causal or not, changes the part of Gw w that is orthogonal to Gu. The norm
of the part that is orthogonal to Gu is a lower bound on the norm of every closed loop. For a suspension, this lower bound is
largest at the invariant point of the wheel (Hedrick, Butsuen 1990).

The frequency and the direction of z are first estimated in floats. The proof is a pair (q, p) with

    [q; p]* [A - j omega, B; C, D] = 0,     so that     p* z = (q* Bw + p* Dw) w     at omega for every u and every x.

The proof is exact, because some entries of q and p are floats, and the remaining entries are computed from these floats in
integers. The existence of a pair therefore does not depend on any tolerance, even at a resonance or near a zero of Gu.

At a pole on the imaginary axis that is unobservable in z, such as an integrator, more pairs (q, p) exist than at nearby
frequencies. The additional pairs exist because a stabilising controller must also cancel the effect of w on the unobservable
mode.
"""

import contextlib
from dataclasses import replace
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.analysis.lower_bounds.exact_algebra import Nullspace, identity, root_below, without_factors
from synth.analysis.norm import largest_singular_values
from synth.analysis.rigorous import floats, integers, product, zeros
from synth.analysis.stability import balance, stability
from synth.plant.generalized import Plant, check_continuous
from synth.plant.units import own_units

PEAKS = 6  # number of local maxima from which the search is refined
# a singular value of Gu below this multiple of the largest one counts as zero in the floating-point estimate
NEGLIGIBLE = 1e-10
AWAY = 1e-9  # a frequency that coincides with a pole on the imaginary axis is changed by this relative amount
# factor by which `AWAY` is multiplied if the matrix is still singular, for example near a multiple pole
FURTHER = 10.0
ENOUGH = 1e-9  # an estimate is tried only if it exceeds the best proved bound by at least this relative amount
UNCHANGED_NORM = (
    # the norm without control counts as equal to the limit if their relative difference is smaller than this; rounding errors
    # are far smaller
    1e-3
)


def invariant_limit(plant: Plant) -> tuple[float, float] | None:
    """Returns the largest part of the gain from w to z that no controller can change, and the frequency [rad/s] of this part.

    The result is None if the control affects every direction of z.
    """
    check_continuous(plant)
    rates = _rates(plant)
    largest = float(rates.max())
    smallest = float(rates[rates > 1e-6 * largest].min())
    omega = np.geomspace(1e-2 * smallest, 1e2 * largest, 500)
    norms = largest_singular_values(_invariant_part(plant, omega))
    tops = np.flatnonzero((norms[1:-1] >= norms[:-2]) & (norms[1:-1] >= norms[2:])) + 1
    tops = np.unique([*tops[np.argsort(norms[tops])[-PEAKS:]], norms.argmax()])
    middle, height, width = omega[tops], norms[tops], omega[1] / omega[0] - 1
    for _ in range(9):  # all of the highest points are refined together
        near = middle * (1 + width * np.linspace(-1, 1, 11)[:, None])
        norms = largest_singular_values(_invariant_part(plant, near.ravel())).reshape(near.shape)
        highest = norms.argmax(axis=0)
        index = np.arange(len(middle))
        middle, height, width = near[highest, index], norms[highest, index], width / 5
    middle, height = np.append(middle, 0.0), np.append(height, largest_singular_values(_invariant_part(plant, np.zeros(1))))
    best, at = max(((limit_at(plant, pole), pole) for pole in _poles_on_axis(plant)), default=(0.0, 0.0))
    for expected, proposal in sorted(zip(height.tolist(), middle.tolist(), strict=True), reverse=True):
        if expected > best * (1 + ENOUGH):
            best, at = max((best, at), (limit_at(plant, proposal), proposal))
    return (best, at) if best else None


def limit_at(plant: Plant, omega: float) -> float:
    """Returns a proved lower bound on the gain at omega [rad/s] for all controllers; 0 if nothing is proved."""
    return proof_at(plant, omega)[0]


@np.errstate(all="ignore")  # a value that is infinite or NaN never counts as a proof
def proof_at(plant: Plant, omega: float) -> tuple[float, Array]:
    """Returns the lower bound that `limit_at` gives, and the pair (q, p) that proves this bound.

    Returns:
        The lower bound, and a vector of 2 (n + d) integers: the real parts of q and p, followed by the imaginary parts of q and
        p (see `_equations`).
    """
    n, d = len(plant.A), len(plant.C)
    real, imaginary, from_w, unit = _equations(plant, omega)
    solutions = Nullspace(np.vstack([np.hstack([real, imaginary]), np.hstack([imaginary, -real])]))
    if not solutions.free:
        return 0.0, zeros(0)
    outputs = [*range(n, n + d), *range(2 * n + d, 2 * (n + d))]

    def proved(guess: Array) -> tuple[float, Array]:
        if not np.all(np.isfinite(guess)):
            return 0.0, zeros(0)
        solution = solutions.complete(integers(guess[:, None])[0])
        effect = product(solution.T, from_w)
        length = int(np.sum(solution[outputs] ** 2))
        with contextlib.suppress(OverflowError):
            return root_below(Fraction(int(np.sum(effect**2)), unit**2 * length)) if length else 0.0, solution[:, 0]
        return 0.0, zeros(0)

    p, q = _guess(plant, omega)
    best = proved(np.concatenate([np.real(q), np.real(p), np.imag(q), np.imag(p)])[solutions.free])
    if not is_pole(plant, omega):
        return best
    whole, over = without_factors(solutions.complete(identity(len(solutions.free))))
    basis = floats(whole, Fraction(1, over))
    effects = basis.T @ floats(from_w, Fraction(1, unit))
    return max(best, proved(basis[solutions.free] @ _strongest(basis[outputs].T, effects)), key=lambda one: one[0])


def without_control(plant: Plant, omega: float) -> float:
    """Returns the largest gain from w to z without control at the frequency omega [rad/s], which must not be a pole."""
    return float(largest_singular_values(plant.frequency_response(np.array([omega])))[0])


def _equations(plant: Plant, omega: float) -> tuple[Array, Array, Array, int]:
    """Returns, in integers, M = [A - j omega, B; C, D] and the matrix that maps [q; p]* to the effect of w.

    The complex vector [q; p] is stored as a real vector: first the real parts of all entries, then the imaginary parts. For a
    discrete plant, the point z = (1 + j t) / (1 - j t) is used, where t = tan(omega dt / 2) is a float. The point z is exactly
    on the unit circle. The rows of the matrix that belong to the states are multiplied by 1 - j t.

    Returns:
        The real part and the imaginary part of M, both multiplied by the same factor, each of shape (n + d, n + m). The matrix
        that describes the effects of w on the real and imaginary parts of p* z, shape (2 (n + d), 2 r), and its denominator.
    """
    n, m = plant.B.shape
    system, unit = integers(plant.system_matrix)
    turns, over = integers(np.array([omega if plant.dt is None else np.tan(omega * plant.dt / 2)]))
    turn, states = int(turns[0]), zeros(*system.shape)
    states[np.arange(n), np.arange(n)] = unit
    if plant.dt is None:
        real, imaginary = system * over, -turn * states
    else:
        above = zeros(*system.shape)
        above[:n] = system[:n]
        real, imaginary = (system - states) * over, -turn * (above + states)
    direct, turned = real[:, n + m :], imaginary[:, n + m :]
    return (
        real[:, : n + m],
        imaginary[:, : n + m],
        np.vstack([np.hstack([direct, turned]), np.hstack([turned, -direct])]),
        unit * over,
    )


def limit_at_infinity(plant: Plant) -> float:
    """Returns a proved lower bound on the gain at infinite frequency for all proper controllers that measure y = C_y x + Dyw w.

    The bound is the norm of Dw, restricted to disturbances without feedthrough to y, or to outputs without feedthrough from the
    control forces. The bound is 0 if no bound can be proved.
    """
    return max(_limit_beside(plant.Dyw.T, plant.Dw), _limit_beside(plant.D, plant.Dw.T))


def _limit_beside(K: Array, direct: Array) -> float:
    """Returns a proved lower bound on the norm of the matrix `direct` for vectors v with K' v = 0; 0 if v = 0 is the only such
    vector.
    """
    silent = Nullspace(integers(K)[0])
    if not silent.free or not direct.any():
        return 0.0
    basis, over = without_factors(silent.complete(identity(len(silent.free))))
    free = floats(basis, Fraction(1, over))
    v = silent.complete(integers((_strongest(free.T, free.T @ direct.T))[:, None])[0])
    whole, unit = integers(direct)
    with contextlib.suppress(OverflowError):
        own = int(np.sum(v**2))
        return root_below(Fraction(int(np.sum(product(whole, v) ** 2)), unit**2 * own)) if own else 0.0
    return 0.0


def is_pole(plant: Plant, omega: float) -> bool:
    """Returns True if j omega is numerically equal to a pole; for an integrator, this is the case at omega = 0."""
    return bool(np.linalg.matrix_rank(_states(replace(plant, A=balance(plant.A)[0]), omega)) < len(plant.A))


def _states(plant: Plant, omega: float) -> Array:
    """Returns A - j omega; for a discrete plant, returns the matrix that `_equations` uses instead of A - j omega."""
    eye = np.eye(len(plant.A))
    if plant.dt is None:
        return plant.A - 1j * omega * eye
    return plant.A - eye - 1j * np.tan(omega * plant.dt / 2) * (plant.A + eye)


def _poles_on_axis(plant: Plant) -> list[float]:
    """Returns the frequencies [rad/s] of the poles that are numerically on the imaginary axis."""
    open_loop = stability(plant.A)
    near = np.unique(np.append(np.abs(np.imag(open_loop.poles[open_loop.on_axis])), 0.0))
    return [omega for omega in near.tolist() if is_pole(plant, omega)]


def _strongest(outputs: Array, effects: Array) -> Array:
    """Returns the vector x with the largest |x' effects| / |x' outputs|; directions with x' outputs = 0 are excluded.

    Args:
        outputs: matrix of shape (k, d).
        effects: matrix of shape (k, r).
    """
    directions, sizes, _ = np.linalg.svd(outputs, full_matrices=False)
    mask = sizes > NEGLIGIBLE * sizes.max(initial=0.0)
    directions = directions[:, mask] / sizes[mask]
    return directions @ np.linalg.svd(directions.T @ effects)[0][:, 0] if mask.any() else np.zeros(len(outputs))


def _rates(plant: Plant) -> Array:
    """Returns the positive magnitudes of the plant's poles [rad/s].

    If all poles are at 0, returns the rate of the plant that `own_units` computes.

    Rounding can move an n-fold pole at 0 by up to the n-th root of the rounding error.
    """
    A, _ = balance(plant.A)
    poles = np.abs(np.linalg.eigvals(A))
    poles = poles[poles > 0]
    if len(poles) and poles.max() > np.finfo(float).eps ** (1 / len(A)) * np.linalg.norm(A):
        return poles
    return np.append(poles, own_units(plant).rate)


def _invariant_part(plant: Plant, omega: Array, away: float = AWAY) -> Array:
    """Returns the part of Gw that is orthogonal to Gu, at each of F frequencies `omega` [rad/s], complex, shape (F, d, r)."""
    try:
        both = plant.unchecked(Bw=np.hstack([plant.Bw, plant.B]), Dw=np.hstack([plant.Dw, plant.D]))
        from_w, from_u = np.split(both.frequency_response(omega), [plant.Bw.shape[1]], axis=2)
    except np.linalg.LinAlgError:  # the frequency is equal to a pole, up to rounding
        return _invariant_part(plant, _off_poles(plant, omega, away), FURTHER * away)
    columns = np.linalg.norm(from_u, axis=1, keepdims=True)
    directions, sizes, _ = np.linalg.svd(from_u / np.where(columns > 0, columns, 1.0), full_matrices=False)
    directions = directions * (sizes > NEGLIGIBLE * sizes.max(axis=1, keepdims=True, initial=0.0))[:, None]
    return from_w - directions @ (directions.conj().swapaxes(1, 2) @ from_w)


def _guess(plant: Plant, omega: float, away: float = AWAY) -> tuple[Array, Array]:
    """Returns approximations of the vectors p and q that give the largest bound at the frequency omega [rad/s], complex, shapes
    (d,) and (n,).
    """
    where, there = plant, omega
    if plant.dt is not None:
        from synth.plant.discrete import continuous_image, mapped_frequency

        where, there = continuous_image(plant.measured(np.eye(len(plant.A))))[0], mapped_frequency(omega, plant.dt)
    p = np.linalg.svd(_invariant_part(where, np.array([there]))[0])[0][:, 0]
    try:
        return p, np.linalg.solve(-_states(plant, omega).conj().T, plant.C.T @ p)
    except np.linalg.LinAlgError:
        return _guess(plant, float(_off_poles(plant, np.array([omega]), away)[0]), FURTHER * away)


def _off_poles(plant: Plant, omega: Array, away: float) -> Array:
    """Returns frequencies slightly above `omega` at which there is no pole."""
    return omega * (1 + away) + away * _rates(plant).max() * (omega == 0)
