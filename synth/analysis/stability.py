"""Stability of a loop: stable, marginal or unstable.

Computed eigenvalues are the exact eigenvalues of a matrix A + E, where |E| is about eps |A|. A pole with the imaginary part
omega is on the imaginary axis *up to rounding* if such an E can move an eigenvalue to j omega. Such an E exists if the smallest
singular value of A - j omega is at most |E| (Trefethen, Embree 2005, Spectra and Pseudospectra, section 2). For a simple pole,
the largest distance from the axis that rounding can cause is the condition number of the eigenvalue times |E|.

The criterion also holds for multiple poles, although their condition number is infinite. Rounding moves a double pole by about
sqrt(eps). Nevertheless, a double pole at the origin counts as marginal, and a double pole at -1 counts as stable.
"""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from models.common.arrays import Array
from models.common.printed import rough
from synth.plant.generalized import Plant

STABLE, MARGINAL, UNSTABLE = "stable", "marginal", "unstable"
FAR = 1e3  # a pole counts as off the axis if its distance from the axis exceeds this multiple of the first-order rounding error
LARGE, SEVERAL = 64, 8  # numbers of states and of tested points above which a Schur form saves time
PART = 400  # largest number of rows in a part of the Schur form; the bound is too weak for larger parts


@dataclass(frozen=True, eq=False)
class Stability:
    """Poles of a loop, and whether the loop is stable.

    Attributes:
        poles: sorted eigenvalues of A [rad/s], complex, shape (n,); for a discrete loop, dimensionless poles z.
        on_axis: mask of the poles that are on the imaginary axis (discrete: on the unit circle) up to rounding, shape (n,).
        rounding: norm of E, which describes the effect of rounding errors on A [rad/s]; dimensionless for a discrete loop.
        vectors: right eigenvectors of the balanced A, each of length 1, complex, shape (n, n).
        dt: sample period of a discrete loop [s]; None for a continuous loop.
    """

    poles: Array
    on_axis: Array
    rounding: float
    vectors: Array
    dt: float | None = None

    @property
    def growth(self) -> Array:
        """Real parts of the poles (for a discrete loop: |z| - 1), shape (n,); negative if the pole decays."""
        return np.real(self.poles) if self.dt is None else np.abs(self.poles) - 1

    @property
    def rates(self) -> Array:
        """Magnitudes of the poles [rad/s] (for a discrete loop: |z - 1| / dt), shape (n,)."""
        return np.abs(self.poles) if self.dt is None else np.abs(self.poles - 1) / self.dt

    @property
    def verdict(self) -> str:
        """`STABLE`, `MARGINAL` or `UNSTABLE`.

        A marginal loop has a pole that does not decay, but no pole that is unstable by more than rounding errors.
        """
        if np.any(self.growth[~self.on_axis] > 0):
            return UNSTABLE
        return MARGINAL if np.any(self.on_axis) else STABLE

    @property
    def stable(self) -> bool:
        """True if no pole is unstable or so close to the stability limit that rounding could hide an unstable pole."""
        return self.verdict == STABLE

    @property
    def worst(self) -> complex:
        """Pole that decides the stability: the fastest-growing pole, or a pole on the stability limit if no pole grows.

        For a loop without poles, the attribute is -inf, or z = 0 if the loop is discrete.
        """
        deciding, growth = self.poles, self.growth
        if self.verdict == MARGINAL:
            deciding, growth = deciding[self.on_axis], growth[self.on_axis]
        if not len(deciding):
            return complex(-np.inf) if self.dt is None else 0j
        return complex(deciding[np.argmax(growth)])

    @property
    def words(self) -> str:
        """One-line description of the stability verdict and of the pole that decides the verdict."""
        if self.dt is not None:
            where = pole_text(self.worst, self.dt)
            if self.verdict == STABLE:
                return f"stable, slowest pole at {where}"
            if self.verdict == MARGINAL:
                return f"marginal: a pole at {where} is on the unit circle (within rounding) and does not decay"
            return f"unstable: a pole at {where}"
        if self.verdict == STABLE:
            return f"stable, slowest pole {rough(self.worst.real)} 1/s"
        if self.verdict == MARGINAL:
            at = abs(self.worst.imag)
            where = f"0+{rough(at)}j" if at > self.rounding else "0"
            return f"marginal: a pole at {where} rad/s does not decay (within rounding)"
        return f"unstable: a pole at {pole_text(self.worst)}"


def stability(A: Array, dt: float | None = None) -> Stability:
    """Returns the poles of x' = A x, or of x[k+1] = A x[k], and whether the poles are stable.

    Args:
        A: finite matrix, shape (n, n).
        dt: sample period [s]; None for a continuous loop.
    """
    balanced = balance(A)[0]
    if dt is None:
        return stability_of_balanced(balanced)
    poles, conditions, vectors = _eigen(balanced)
    return Stability(poles, _on_circle(balanced, poles, conditions), rounding(balanced), vectors, dt)


def stability_of_balanced(A: Array) -> Stability:
    """Returns the stability of a continuous loop, given the balanced state matrix of the loop; see `stability`."""
    poles, conditions, vectors = _eigen(A)
    on_axis = _within_rounding(A, conditions, 1j * np.imag(poles), np.abs(np.real(poles)))
    return Stability(poles, on_axis, rounding(A), vectors)


def sampled_growth(Phi: Array) -> float:
    """Returns the spectral radius of a finite matrix Phi, shape (n, n).

    If the radius is 1 up to rounding, returns exactly 1.
    """
    Phi, _ = balance(Phi)
    poles, conditions, _ = _eigen(Phi)
    size = np.abs(poles)
    # Poles outside the unit circle are checked first. If one pole is outside by more than a rounding error, the other poles,
    # which can be hundreds with a delay, need no check.
    outside = size > 1
    on_circle = _on_circle(Phi, poles, conditions, outside)
    if np.any(outside & ~on_circle):
        return float(size.max())
    marginal = np.any(on_circle) or np.any(_on_circle(Phi, poles, conditions, ~outside))
    return 1.0 if marginal else float(size.max(initial=0.0))


def is_stable(A: Array, dt: float | None = None) -> bool:
    """Returns True if every pole is stable, even if rounding errors are considered; see `stability`."""
    return stability(A, dt).stable


def balance(A: Array) -> tuple[Array, Array]:
    """Returns the balanced matrix S^-1 A S, whose rows and columns have similar size, and the diagonal of S, shape (n,)."""
    if not len(A):
        return A, np.ones(0)
    balanced, (scale, _) = linalg.matrix_balance(A, permute=False, separate=True)
    return np.asarray(balanced), np.asarray(scale)


def rounding(A: Array) -> float:
    """Returns the norm of E, where E is the backward error of the eigenvalues of a balanced matrix of shape (n, n)."""
    return 10 * np.finfo(float).eps * float(np.linalg.norm(A)) if len(A) else 0.0


def pole_text(pole: complex, dt: float | None = None) -> str:
    """Formats a pole or a conjugate pair of poles as text, with four digits and the unit. A real pole is described as a rate of
    growth or decay.

    For a discrete loop, the text has enough digits to show that z is not on the unit circle.
    """
    if dt is not None:
        size = abs(pole)
        digits = 4 if size == 1 else int(np.clip(2 - np.floor(np.log10(abs(size - 1))), 4, 12))
        turning = f"{abs(pole.imag):+.{digits}g}j, |z| = {size:.{digits}g}" if pole.imag else ""
        return f"z = {pole.real:.{digits}g}{turning}"
    if pole.imag:
        return f"{rough(pole.real)}{abs(pole.imag):+.4g}j rad/s"
    return f"{rough(pole.real)} {'1/s' if pole.real else 'rad/s'}"


def _eigen(A: Array) -> tuple[Array, Array, Array]:
    """Returns the eigenvalues (complex, sorted), their condition numbers (infinite for defective eigenvalues), and the right
    eigenvectors.
    """
    if not len(A):
        return np.zeros(0, dtype=complex), np.zeros(0), np.zeros((0, 0), dtype=complex)
    poles, left, right = (np.asarray(part) for part in linalg.eig(A, left=True, right=True))
    with np.errstate(divide="ignore", over="ignore"):
        conditions = 1 / np.abs(np.sum(left.conj() * right, axis=0))  # each eigenvector has length 1
    order = np.lexsort((np.imag(poles), np.real(poles)))
    return poles[order].astype(complex), conditions[order], right[:, order].astype(complex)


def _on_circle(A: Array, poles: Array, conditions: Array, asked: Array | bool = True) -> Array:
    """Returns a mask, shape (n,): True for eigenvalues that `asked` selects and that are on the unit circle up to rounding."""
    distances = np.where(asked, np.abs(np.abs(poles) - 1), np.inf)
    return _within_rounding(A, conditions, np.exp(1j * np.angle(poles)), distances)


def _within_rounding(A: Array, conditions: Array, points: Array, distances: Array) -> Array:
    """Returns a mask, shape (n,): True for each eigenvalue of a balanced matrix that rounding could move to the corresponding
    point.
    """
    allowed = rounding(A)
    # The condition number limits how far a pole can move, to first order. Poles that are much farther from their points are
    # skipped.
    near = np.flatnonzero((distances <= FAR * allowed * conditions) & (distances < np.inf))
    pairs = [(float(points[i].real), float(abs(points[i].imag))) for i in near]  # conjugate points give the same result
    known = _nearly_singular(A, dict.fromkeys(pairs), allowed)
    mask = np.zeros(len(A), dtype=bool)
    mask[near] = [known[pair] for pair in pairs]
    return mask


def _nearly_singular(A: Array, points: Iterable[tuple[float, float]], distance: float) -> dict[tuple[float, float], bool]:
    """Returns, for each point p, True if a singular matrix exists within `distance` of A - p I.

    A singular matrix exists within this distance if the smallest singular value of A - p I is at most the distance. Each point
    is given by its real part and its imaginary part.
    """
    points = list(points)
    # A delay adds many states. A Schur form is therefore computed once, so that the bound at each point takes far less time.
    schur = len(A) > LARGE and len(points) > SEVERAL
    inverse_size = _Triangle(A).inverse_size if schur else lambda p: float(np.linalg.norm(np.linalg.inv(A - p * np.eye(len(A)))))

    def at(p: complex) -> bool:
        try:
            # Computing a lower bound on the smallest singular value takes a tenth of the time that the value itself takes.
            if 1 / inverse_size(p) > 2 * distance:
                return False
        except np.linalg.LinAlgError:
            return True
        return bool(np.linalg.svd(A - p * np.eye(len(A)), compute_uv=False)[-1] <= distance)

    return {pair: at(complex(*pair)) for pair in points}


class _Triangle:
    """Schur form T of a matrix, divided into blocks (called parts) of size k x k."""

    def __init__(self, A: Array) -> None:
        T = linalg.rsf2csf(linalg.schur(A)[0], np.eye(len(A)))[0]
        edges = np.linspace(0, len(A), 1 + -(-len(A) // PART)).astype(int)
        slices = [slice(*pair) for pair in itertools.pairwise(edges)]
        self.diagonal = [T[each, each] for each in slices]
        # The geometric mean of the largest row sum and the largest column sum is at least the largest singular value.
        sizes = np.abs(T)
        self.beside = np.array(
            [[math.sqrt(sizes[i, j].sum(axis=0).max() * sizes[i, j].sum(axis=1).max()) for j in slices] for i in slices]
        )

    def inverse_size(self, p: complex) -> float:
        """Returns an upper bound on the norm of (T - p I)^-1, by back substitution with the norms of the parts.

        Raises:
            LinAlgError: T - p I is singular.
        """
        own = [float(np.linalg.norm(_inverse_of_triangle(part - p * np.eye(len(part))))) for part in self.diagonal]
        bound = np.diag(own)
        for i in range(len(own) - 2, -1, -1):
            bound[i, i + 1 :] = own[i] * (self.beside[i, i + 1 :] @ bound[i + 1 :, i + 1 :])
        return float(np.linalg.norm(bound))


def _inverse_of_triangle(matrix: Array) -> Array:
    """Returns the inverse of an upper triangular complex matrix.

    Raises:
        LinAlgError: the matrix is singular.
    """
    inverse, singular = lapack.ztrtri(matrix)  # pyright: ignore[reportAttributeAccessIssue] - made by f2py, without stubs
    if singular:
        raise np.linalg.LinAlgError("a diagonal entry of the factor is 0")
    return inverse


def beside_weights(plant: Plant, A: Array) -> Array:
    """Returns the state matrix of a closed loop without the states of weighting filters; no controller can change the poles of
    these filters.

    Args:
        plant: plant without a controller, with n states.
        A: state matrix of a loop whose first n states are the states of the plant, shape (n + k, n + k).
    """
    n = len(plant.A)
    own = np.r_[: n - plant.weights, n : len(A)]
    return A[np.ix_(own, own)] if plant.weights else A
