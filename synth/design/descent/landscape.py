"""The norm as a function of the gain: the value and slope of the norm, and smooth functions that bound it from below.

A gain K is represented by a point x of N numbers with K_ij = x_ij scale_ij. The scales give every entry of K a similar effect.
N is m q, or the number of free entries if a structure fixes the other entries to zero. The H-infinity norm is a continuous
function of the gain. The norm has an edge wherever two frequencies or two singular values share the maximum, and minima lie on
edges. For all unit vectors u and v, the largest singular value of the transfer matrix T(j omega) is at least Re u' T(j omega)
v. Equality holds for the singular vectors. Each choice of omega, u and v therefore gives a smooth function that bounds the norm
from below. The smooth function for one choice of omega, u and v is called a cut (Apkarian, Noll 2006).

A discrete plant is represented by the continuous plant into which the bilinear transform maps it, with the same gains but other
frequencies. The measurements of the continuous plant contain the force, as an accelerometer signal does. The equivalent gain
for measurements without the force is (I - K Dyu)^-1 K.

If two measurements are large and nearly equal, the norm depends strongly on the gain that acts on their sum. The norm hardly
depends on the gain that acts on the difference of the two measurements. An example is a slowly drifting reference and a
position that follows this reference. A similar problem occurs if two forces nearly cancel in z. If two measurements are nearly
equal, or two forces nearly cancel, the norm has a narrow valley as a function of the gain entries. A change dK of the gain
changes z by T_zu dK T_yw w, where T_zu and T_yw are transfer matrices of the closed loop. In suitable coordinates for the gain,
the norm has no narrow valley. The coordinates are chosen so that the measurements are uncorrelated and of equal size if w is
white noise. In the same coordinates, the responses of z to white-noise forces are orthogonal and of equal size. The curvature
of a quadratic cost is then the same in all directions (natural gradient).
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from models.common.arrays import Array
from synth.analysis.norm import ILL_CONDITIONED, largest_singular_values, level_crossings
from synth.analysis.stability import balance
from synth.plant.discrete import continuous_image, mapped_frequency
from synth.plant.generalized import Plant

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and has no type stubs.

FAR = 1e4  # a frequency above this multiple of the fastest pole counts as infinite
EVERYWHERE = (0.0, np.inf)
Band = tuple[float, float]  # lower and upper frequency [rad/s]
POLES = 0.3  # computing work for the poles alone, relative to the work for a norm


@dataclass(frozen=True, eq=False)
class Modes:
    """Closed loop, with its poles and modes.

    Attributes:
        loop: closed loop from `Landscape.loop`.
        poles: poles of the loop, shape (n,).
        residues: residues C v w' Bw of all modes, with right and left eigenvectors v and w, shape (n, d r). Residues make
            frequency responses fast to compute. None if the eigenvectors are too inaccurate.
        vectors: matrix with the right eigenvectors as columns, and its inverse, whose rows are the left eigenvectors, shapes
            (n, n); None if `residues` is None.
    """

    loop: Plant
    poles: Array
    residues: Array | None = None
    vectors: tuple[Array, Array] | None = None

    @cached_property
    def far(self) -> Array:
        """Finite frequency at which the gain is close to the gain at infinite frequency [rad/s], shape (1,).

        Cuts need finite frequencies.
        """
        return FAR * np.abs(self.poles).max(keepdims=True)

    @cached_property
    def at_infinity(self) -> float:
        """Gain from w to z at infinite frequency."""
        return float(np.linalg.norm(self.loop.Dw, 2)) if self.loop.Dw.any() else 0.0


@dataclass(frozen=True, eq=False)
class Cuts:
    """Set of F cuts: smooth functions Re u' T(j omega; K) v of the gain K that bound the norm from below.

    Attributes:
        omega: frequency of each cut [rad/s], shape (F,).
        u: complex unit vector u of each cut, shape (F, d).
        v: complex unit vector v of each cut, shape (F, r).
    """

    omega: Array
    u: Array
    v: Array

    def __getitem__(self, index: Array | slice) -> "Cuts":
        return Cuts(self.omega[index], self.u[index], self.v[index])

    def __add__(self, other: "Cuts") -> "Cuts":
        return Cuts(
            np.concatenate([self.omega, other.omega]), np.concatenate([self.u, other.u]), np.concatenate([self.v, other.v])
        )


def refine_maxima(gains: Callable[[Array], Array], left: Array, middle: Array, right: Array, height: Array) -> Array:
    """Refines the frequencies of local maxima of a gain.

    In each step, the vertex of the parabola through three points becomes the middle point.

    Returns:
        The refined frequencies, shape (P,).

    Args:
        gains: function that returns the gain at each frequency; it must be an even function of frequency.
        left, middle, right: frequencies below, near and above each of P maxima, shape (P,) each.
        height: gain at each middle frequency, shape (P,).
    """
    for _ in range(3):
        sides = gains(np.abs(np.concatenate([left, right]))).reshape(2, -1)
        a, b = middle - left, right - middle
        rise, drop = (height - sides[0]) / a, (height - sides[1]) / b
        bend = np.maximum(rise + drop, 1e-300)
        vertex = np.clip(middle + 0.5 * (rise * b - drop * a) / bend, left, right)
        there = gains(np.abs(vertex))
        higher = there > height
        middle, height = np.where(higher, vertex, middle), np.where(higher, there, height)
        width = np.maximum(0.2 * np.minimum(a, b), 1e-7 * np.abs(middle))
        left, right = middle - width, middle + width
    return middle


NEAR = 1e-9  # the search for the peak ends if the norm exceeds the best value by less than this relative amount
ALIKE = 0.02  # eigenvalues count as equal if their relative difference is smaller than this
MOST_ALIKE = 3  # largest number of similar singular values that are considered at one frequency


class Work:
    """Counter of computing work, with a limit. One unit is the work that is needed to compute one norm of a loop with 8 states.

    Unlike a time limit, a limit on the counted work has the same effect on every machine. A search for the same problem
    therefore always ends at the same gain.
    """

    def __init__(self, limit: float = np.inf) -> None:
        self.limit, self.done = limit, 0.0

    @property
    def over(self) -> bool:
        """True if the counted computing work has reached the limit."""
        return self.done >= self.limit

    @property
    def text(self) -> str:
        """Reason why a search stopped, as text."""
        return f"the search stopped at its limit of {self.limit:g} computed norms"


def price(states: int, entries: int) -> float:
    """Returns the computing work for one norm, with its slopes and curvatures for a descent over `entries` gain entries."""
    return (0.4 + 0.6 * (states / 8) ** 2) * (1 + entries / 60)


class Landscape:
    """Norms of the closed loops of one plant as a function of the gain.

    The object stores previous peak frequencies, which shorten the next search for a norm but do not change the norm.
    """

    def __init__(
        self,
        plant: Plant,
        structure: Array | None = None,
        work: Work | None = None,
        band: Band = EVERYWHERE,
    ) -> None:
        """Args:
        plant: generalised plant with n states, m inputs, r disturbances and q measurements.
        structure: mask, shape (m, q): True for entries of K that may be nonzero. None if all entries may be nonzero.
        work: counter of the computing work that is spent on norms. Default: a counter without a limit.
        band: lower and upper limit of the frequencies [rad/s] over which the norm is taken; all frequencies by default.
        """
        image, self.before = continuous_image(plant)
        self.band = mapped_frequency(band[0], plant.dt), mapped_frequency(band[1], plant.dt)
        A, self.balancing = balance(image.A)
        each = self.balancing[:, None]
        inputs = {"B": image.B / each, "Bw": image.Bw / each}
        plant = image.unchecked(A=A, C=image.C * self.balancing, Cy=image.Cy * self.balancing, **inputs)
        self.plant, self.through, self.noisy = plant, bool(np.any(plant.Dyu)), bool(np.any(plant.Dyw))
        self.shape = plant.Dyu.T.shape
        columns, rows = np.linalg.norm(plant.B, axis=0), np.linalg.norm(plant.Cy, axis=1)
        rate = float(np.linalg.norm(A, 2)) or 1.0
        columns = np.where(columns > 0, columns, 1.0)
        # a measurement that contains only forces has a zero row in Cy
        of_forces = np.linalg.norm(plant.Dyu * rate / columns, axis=1)
        rows = np.where(rows > 0, rows, np.where(of_forces > 0, of_forces, 1.0))
        self.scale = rate / np.outer(columns, rows)
        self.free = None if structure is None or np.all(structure) else np.flatnonzero(structure)
        self.work, self.price = work or Work(), price(len(A), self.scale.size if self.free is None else len(self.free))
        self.peaks: list[float] = []
        self.last: tuple[bytes, Plant] | None = None
        self.last_modes: Modes | None = None

    def gain(self, x: Array) -> Array:
        """Returns the gain K of one or more points, shape (..., m, q)."""
        if self.free is not None:
            some, x = x, np.zeros((*x.shape[:-1], self.scale.size))
            x[..., self.free] = some
        return x.reshape(*x.shape[:-1], *self.shape) * self.scale

    def point(self, K: Array) -> Array:
        """Returns the point x that represents a gain, shape (N,)."""
        return self.of_entries(K / self.scale)

    def of_entries(self, values: Array) -> Array:
        """Converts values for the entries of K, shape (..., m, q), to values for the coordinates of a point, shape (..., N)."""
        flat = values.reshape(*values.shape[:-2], self.scale.size)
        return flat if self.free is None else flat[..., self.free]

    def acting(self, x: Array) -> Array:
        """Returns, for each point, the gain (I - K Dyu)^-1 K, which has the same effect without Dyu, shape (..., m, q); NaN if
        none exists.
        """
        K = self.gain(x) - self.before
        if not self.through:
            return K
        if x.ndim == 1:
            return self.after(x) @ K
        with contextlib.suppress(np.linalg.LinAlgError):  # the algebraic loop has no solution
            return np.linalg.solve(np.eye(self.shape[0]) - K @ self.plant.Dyu, K)
        return np.full_like(K, np.nan)

    def after(self, x: Array) -> Array:
        """Returns the matrix (I - K Dyu)^-1 for a point, shape (m, m); NaN if the inverse does not exist."""
        eye = np.eye(self.shape[0])
        if not self.through:
            return eye
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.linalg.inv(eye - (self.gain(x) - self.before) @ self.plant.Dyu)
        return np.full_like(eye, np.nan)

    def point_acting(self, K: Array) -> Array:
        """Returns the point whose gain has the same effect with Dyu as the gain K has without Dyu, shape (N,)."""
        if self.through:
            K = np.linalg.solve(np.eye(self.shape[0]) + K @ self.plant.Dyu, K)
        return self.point(K + self.before)

    def loop(self, x: Array) -> Plant:
        """Returns the closed loop with the gain K of a point.

        The closed loop has an additional input v: u = K y + v. The last result is cached.

        The matrices of the loop describe the effect of a change of the gain, including the effect through Dyu. All entries of
        the matrices are NaN if the loop equation has no solution.
        """
        key = x.tobytes()
        if self.last is None or self.last[0] != key:
            plant, K, ports = self.plant, self.gain(x) - self.before, {}
            if self.through:
                after = self.after(x)
                before = np.eye(self.shape[1]) + plant.Dyu @ after @ K
                ports = {"B": plant.B @ after, "D": plant.D @ after, "Cy": before @ plant.Cy}
                ports |= {"Dyw": before @ plant.Dyw, "Dyu": plant.Dyu @ after}
                K = after @ K
            G = K @ plant.Cy
            parts = {"A": plant.A + plant.B @ G, "C": plant.C + plant.D @ G} | ports
            if self.noisy:
                of_noise = K @ plant.Dyw
                parts |= {"Bw": plant.Bw + plant.B @ of_noise, "Dw": plant.Dw + plant.D @ of_noise}
            self.last = key, plant.unchecked(**parts)
        return self.last[1]

    def abscissa(self, x: Array) -> tuple[float, Array]:
        """Returns the largest real part of the poles [rad/s], and its derivatives with respect to the point, shape (N,).

        The largest real part is infinite if the loop matrix is not finite.
        """
        self.work.done += POLES * self.price
        loop = self.loop(x)
        if not np.isfinite(loop.A).all():
            return np.inf, np.full(x.shape, np.nan)
        poles, left, right = (np.asarray(part) for part in linalg.eig(loop.A, left=True, right=True))
        i = int(np.argmax(np.real(poles)))
        left, right = left[:, i].conj(), right[:, i]
        slope = np.real(np.outer(left @ loop.B, loop.Cy @ right) / (left @ right))
        return float(np.real(poles[i])), self.of_entries(slope * self.scale)

    def modes(self, x: Array) -> Modes:
        """Returns the modes of the loop at a point. The last result is cached."""
        loop = self.loop(x)
        if self.last_modes is None or self.last_modes.loop is not loop:
            if not all(np.isfinite(part).all() for part in (loop.A, loop.C, loop.Bw, loop.Dw)):
                return Modes(loop, np.full(len(loop.A), np.nan))
            poles, V = np.linalg.eig(loop.A)
            residues = vectors = None
            with contextlib.suppress(np.linalg.LinAlgError):
                inverse = np.linalg.inv(V)
                if np.linalg.norm(V) * np.linalg.norm(inverse) < ILL_CONDITIONED:
                    seen, driven = (loop.C @ V).T, inverse @ loop.Bw
                    residues, vectors = (seen[:, :, None] * driven[:, None, :]).reshape(len(poles), -1), (V, inverse)
            self.last_modes = Modes(loop, poles, residues, vectors)
        return self.last_modes

    def norm(self, x: Array, above: float = np.inf) -> tuple[float, float]:
        """Returns the norm and the frequency of its peak [rad/s]; the norm is infinite if the loop is unstable or not finite.

        Args:
            above: limit; if the norm exceeds the limit, the search ends early and returns a lower bound.
        """
        self.work.done += self.price
        modes, (low, high) = self.modes(x), self.band
        poles = modes.poles
        if not (np.real(poles) < -1e-13 * np.abs(poles).max()).all():
            return np.inf, np.nan
        upper = poles[np.imag(poles) >= 0]
        omega = self._inside(np.concatenate([np.imag(upper), np.abs(upper), self.peaks, modes.far[: self.noisy]]))
        best, at = (modes.at_infinity, np.inf) if np.isinf(high) else (0.0, low)
        for turn in range(30):
            gain, i = _highest(self._responses(modes, omega), best * (1 + NEAR))
            if gain > best * (1 + NEAR):
                best, at = gain, float(omega[i])
            elif turn or best == 0:  # in the first iteration, a peak far from all poles may be higher than the gain at infinity
                break
            if best > above:
                break
            omega = self._inside(level_crossings(modes.loop, best * (1 + NEAR)))
            omega = np.concatenate([omega, (omega[:-1] + omega[1:]) / 2])
        if np.isfinite(at):
            self.peaks = [*self.peaks[-5:], at]
        return best, at

    def slope(self, x: Array, at: float) -> Array:
        """Returns the derivatives of the largest singular value at a frequency with respect to the point, shape (N,)."""
        loop = self.loop(x)
        if not np.isfinite(at):
            U, _, Vh = np.linalg.svd(loop.Dw, full_matrices=False)
            return self.of_entries(np.outer(U[:, 0] @ loop.D, loop.Dyw @ Vh[0]) * self.scale)
        shifted = 1j * at * np.eye(len(loop.A)) - loop.A
        reached = np.linalg.solve(shifted, loop.Bw)
        U, _, Vh = np.linalg.svd(loop.C @ reached + loop.Dw, full_matrices=False)
        adjoint, v = U[:, 0].conj(), Vh[0].conj()
        seen = np.linalg.solve(shifted.T, adjoint @ loop.C)
        measured = (loop.Cy @ reached + loop.Dyw) @ v
        return self.of_entries(np.real(np.outer(seen @ loop.B + adjoint @ loop.D, measured) * self.scale))

    def cuts(self, x: Array, omega: Array, floor: float) -> Cuts:
        """Returns cuts for the singular values >= `floor` at given frequencies, and cuts for mixtures of singular vectors with
        similar singular values.

        The largest singular value always gives one cut. If singular values are similar, any mixture of their vectors may give
        the largest value at a nearby point, so four mixtures are added.
        """
        if not len(omega):
            return Cuts(omega, *(np.zeros((0, count), complex) for count in self.plant.Dw.shape))
        U, S, Vh = np.linalg.svd(self.loop(x).frequency_response(omega), full_matrices=False)
        where, u, v = np.arange(len(omega)), [U[:, :, 0]], [Vh[:, 0].conj()]
        for k in range(1, min(S.shape[1], MOST_ALIKE)):
            alike = np.flatnonzero(S[:, k] >= floor)
            if not len(alike):
                break
            where = np.concatenate([where, *[alike] * (1 + 4 * k)])
            left, right = U[alike], Vh[alike].conj()
            u.append(left[:, :, k])
            v.append(right[:, k])
            for other in range(k):
                for phase in (1, -1, 1j, -1j):
                    u.append((left[:, :, k] * phase + left[:, :, other]) / np.sqrt(2))
                    v.append((right[:, k] * phase + right[:, other]) / np.sqrt(2))
        return Cuts(omega[where], np.concatenate(u), np.concatenate(v))

    def heights(self, x: Array, cuts: Cuts) -> tuple[Array, Array]:
        """Returns the values of cuts at a point, shape (F,), and their derivatives with respect to the point, shape (F, N)."""
        loop = self.loop(x)
        n = len(loop.A)
        shifted = np.broadcast_to(-loop.A, (len(cuts.omega), n, n)).astype(complex)
        shifted[:, np.arange(n), np.arange(n)] += 1j * cuts.omega[:, None]
        adjoint = cuts.u.conj()
        driven = np.linalg.solve(shifted, (cuts.v @ loop.Bw.T)[:, :, None])[:, :, 0]  # the vector (j omega - A)^-1 Bw v
        seen = np.linalg.solve(shifted.transpose(0, 2, 1), (adjoint @ loop.C)[:, :, None])[:, :, 0]  # row u' C (j omega - A)^-1
        values = np.real(np.sum(adjoint * (driven @ loop.C.T + cuts.v @ loop.Dw.T), axis=1))
        measured = driven @ loop.Cy.T + cuts.v @ loop.Dyw.T
        slopes = np.real((seen @ loop.B + adjoint @ loop.D)[:, :, None] * measured[:, None, :])
        return values, self.of_entries(slopes * self.scale)

    def curvature(self, x: Array, cuts: Cuts, weights: Array) -> Array:
        """Returns the weighted sum of the second derivatives of the peak gains to which the cuts belong, shape (N, N).

        A peak is the maximum of Re u' T v over unit vectors u, v and nearby frequencies. The maximum over u and v is the
        eigenvalue of J = [0 T; T' 0] with the eigenvector q = (u, v) / sqrt 2. Perturbation theory gives the second derivatives
        of the eigenvalue with respect to x and omega. Since omega follows the maximum, omega is eliminated from the Hessian.
        Terms with nearly equal eigenvalues are omitted, because the cuts with mixed vectors already represent them.
        """
        loop = self.loop(x)
        n, size, (d, r) = len(loop.A), x.size, loop.Dw.shape
        omega, adjoint, v = cuts.omega, cuts.u.conj()[:, None, :], cuts.v[:, :, None]
        R = np.linalg.inv(1j * omega[:, None, None] * np.eye(n) - loop.A)
        left, right = loop.C @ R, R @ loop.Bw
        T, Tu, Tw = left @ loop.Bw + loop.Dw, left @ loop.B + loop.D, loop.Cy @ right + loop.Dyw
        Ty = loop.Cy @ R @ loop.B + loop.Dyu
        Tu_rate, Tw_rate = -1j * (left @ R @ loop.B), -1j * (loop.Cy @ R @ right)
        # First derivatives of T v and of T' u with respect to the entries of x, and then with respect to omega.
        seen, driven = (adjoint @ Tu)[:, 0], (Tw @ v)[:, :, 0]
        along = self.of_entries(Tu[:, :, :, None] * driven[:, None, None, :] * self.scale)
        back = self.of_entries((seen[:, None, :, None] * Tw.swapaxes(1, 2)[:, :, None, :]).conj() * self.scale)
        slide = np.concatenate([-1j * (left @ (right @ v)), (-1j * (adjoint @ left @ right)).conj().swapaxes(1, 2)], axis=1)
        first = np.concatenate([along.reshape(-1, d, size), back.reshape(-1, r, size)], axis=1)
        first = np.concatenate([first, slide], axis=2) / np.sqrt(2)
        # Second derivatives of u' T v with respect to the entries of x and omega.
        second = np.zeros((len(omega), size + 1, size + 1))
        twice = np.einsum("fi,fjk,fl->fijkl", seen, Ty, driven) * self.scale[:, :, None, None] * self.scale
        twice = np.real(twice.reshape(-1, self.scale.size, self.scale.size))
        twice = twice if self.free is None else twice[:, self.free[:, None], self.free]
        second[:, :size, :size] = twice + twice.swapaxes(1, 2)
        mixed = (adjoint @ Tu_rate)[:, 0, :, None] * driven[:, None, :] + seen[:, :, None] * (Tw_rate @ v)[:, None, :, 0]
        second[:, :size, -1] = second[:, -1, :size] = self.of_entries(np.real(mixed * self.scale))
        second[:, -1, -1] = np.real(-2 * adjoint @ left @ R @ right @ v)[:, 0, 0]
        J = np.zeros((len(omega), d + r, d + r), complex)
        J[:, :d, d:], J[:, d:, :d] = T, T.conj().swapaxes(1, 2)
        values, vectors = np.linalg.eigh(J)
        height = np.real(adjoint @ T @ v)[:, 0]
        away = np.abs(height - values) > ALIKE * height
        divided = np.where(away, 1 / np.where(away, height - values, 1.0), 0.0)
        share = vectors.conj().swapaxes(1, 2) @ first
        second += 2 * np.real(share.conj().swapaxes(1, 2) @ (share * divided[:, :, None]))
        top = second[:, -1, -1]
        follows = np.where((top < 0) & self.moving(omega), 1 / np.where(top < 0, top, 1.0), 0.0)
        second -= follows[:, None, None] * second[:, -1, :, None] * second[:, -1, None, :]
        return np.tensordot(weights, second[:, :size, :size], 1)

    def summits(self, x: Array, level: float) -> Array:
        """Returns the frequencies [rad/s] of the local maxima of the gain that exceed a level, shape (P,), ascending.

        An end of the band counts as a maximum if the gain decreases from this end into the band.
        """
        modes, (low, high) = self.modes(x), self.band
        above, beyond = (modes.at_infinity * (1 + 1e-6), self.noisy) if np.isinf(high) else (0.0, False)
        if level <= above and not beyond:
            return self._inside(np.array(self.peaks))
        level = max(level, above)
        edges = self._inside(level_crossings(modes.loop, level))
        between = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(5) + 0.5) / 5
        omega = np.unique(np.concatenate([edges, between.ravel(), self._inside(np.array(self.peaks))]))
        gains = self._gains(modes, omega)
        around = np.concatenate([[0.0], gains, [0.0]])
        top = np.flatnonzero((gains >= level) & (gains >= around[:-2]) & (gains >= around[2:]))
        ends, top = omega[top[(top == 0) | (top == len(omega) - 1)]], top[(top > 0) & (top < len(omega) - 1)]
        sides = omega[top - 1], omega[top], omega[top + 1]
        inside = refine_maxima(partial(self._gains, modes), *sides, gains[top]) if len(top) else omega[:0]
        return np.unique(np.concatenate([ends, np.clip(inside, low, high), modes.far[:beyond]]))

    def moving(self, omega: Array) -> Array:
        """Returns True for each frequency whose peak moves to another frequency if the gain changes.

        A peak at zero frequency does not move, because the response is an even function of frequency. A peak at an end of the
        band does not move, because the gain rises beyond this end.
        """
        low, high = self.band
        return (omega > 0) & (omega > low * (1 + NEAR)) & (omega < high * (1 - NEAR))

    def _inside(self, omega: Array) -> Array:
        """Returns those of the given frequencies that lie within the band, and the finite ends of the band, ascending."""
        low, high = self.band
        omega = omega[np.isfinite(omega) & (omega > low) & (omega < high)]
        return np.unique(np.concatenate([[low], omega, [high] if np.isfinite(high) else []]))

    def _gains(self, modes: Modes, omega: Array) -> Array:
        """Returns the largest singular values at given frequencies, shape (F,)."""
        return largest_singular_values(self._responses(modes, omega))

    def _responses(self, modes: Modes, omega: Array) -> Array:
        """Returns the transfer matrix T at given frequencies, shape (F, d, r)."""
        if modes.residues is None:
            return modes.loop.frequency_response(omega)
        T = (1 / (1j * omega[:, None] - modes.poles)) @ modes.residues
        return T.reshape(len(omega), *modes.loop.Dw.shape) + modes.loop.Dw


# smallest variance of a combination of measurements or of forces, relative to the largest variance. Smaller variances are
# replaced by this value
SMALLEST = 1e-12


def balanced_coordinates(landscape: Landscape, x: Array) -> Array:
    """Returns the matrix M, shape (N, N), which defines balanced coordinates t at a stable point x. The coordinates t represent
    the point x + M t.
    """
    loop = landscape.loop(x)
    triangle, basis = linalg.schur(loop.A)  # pyright: ignore[reportAssignmentType]
    w, y, u, z = basis.T @ loop.Bw, loop.Cy @ basis, basis.T @ loop.B, loop.C @ basis
    # Controllability Gramian from w, and observability Gramian to z. At the stability limit, LAPACK perturbs the poles
    # slightly; the result is accurate enough for scaling.
    reached, scale, _ = lapack.dtrsyl(triangle, triangle, -w @ w.T, trana="N", tranb="T")
    seen, other, _ = lapack.dtrsyl(triangle, triangle, -z.T @ z, trana="T", tranb="N")
    measured = _root(y @ (reached / scale) @ y.T)
    forced = _root(u.T @ (seen / other) @ u)
    M = np.kron(forced, measured) / landscape.scale.ravel()[:, None]
    M = M if landscape.free is None else _within(M, landscape.free)
    return M / np.linalg.norm(M, 2)


def _root(variance: Array) -> Array:
    """Returns the inverse square root of a covariance matrix; the identity if this matrix is zero or not finite."""
    if not np.all(np.isfinite(variance)):  # the loop is at the stability limit
        return np.eye(len(variance))
    sizes, directions = np.linalg.eigh((variance + variance.T) / 2)
    if not sizes[-1] > 0:
        return np.eye(len(variance))
    return directions / np.sqrt(np.maximum(sizes, SMALLEST * sizes[-1])) @ directions.T


def directions(landscape: Landscape, x: Array, free: Array) -> Array:
    """Returns balanced directions in which only the free entries change, as columns, shape (N, number of free entries).

    Args:
        free: indices of the entries of a point that may be nonzero.
    """
    try:
        M = balanced_coordinates(landscape, x)
        within = _within(M, free)
    except np.linalg.LinAlgError:
        return np.eye(len(x))[:, free]
    if len(free) == len(x):
        return M
    restricted = np.zeros((len(x), len(free)))
    restricted[free] = within
    return restricted


def _within(M: Array, free: Array) -> Array:
    """Returns a square matrix of balanced coordinates for only the free entries. Each step has the same length in the returned
    coordinates as in the coordinates M.

    Raises:
        LinAlgError: M is singular.
    """
    inverse = np.linalg.inv(M)
    sizes, vectors = np.linalg.eigh((inverse.T @ inverse)[free][:, free])
    return vectors / np.sqrt(np.maximum(sizes, 1e-12 * sizes[-1])) @ vectors.T


def _highest(T: Array, above: float) -> tuple[float, int]:
    """Returns the largest singular value among F matrices, T of shape (F, d, r), and the index of the matrix to which it
    belongs.

    Singular values up to `above` are ignored. If no singular value exceeds `above`, returns 0 and the index -1. Most matrices
    are excluded by their Frobenius norm, which is cheap to compute.
    """
    squares = (np.real(T) ** 2 + np.imag(T) ** 2).reshape(len(T), -1).sum(axis=1)
    among = np.flatnonzero(~(squares <= above * above))
    if not len(among):
        return 0.0, -1
    gains = largest_singular_values(T[among])
    i = int(gains.argmax())
    return float(gains[i]), int(among[i])
