"""What is true of a gain, checked with numpy alone and without the solver that found it."""

from dataclasses import dataclass

import numpy as np

from models.arrays import Array
from synth.bounded_real import bounded_real_matrix
from synth.lower_bound import LowerBound
from synth.norm import Norm, balance, hinf_norm
from synth.plant import GeneralizedPlant

FASTEST = 100.0  # times the plant: an actuator of such a speed hardly exists
BELOW = 1e-9  # relative; how far rounding may put a norm below what no controller can beat
ROUTES_AGREE = 1e-6  # relative; the two norms of a well-conditioned plant agree to 1e-12


@dataclass(frozen=True, eq=False)
class Certificate:
    """Everything claimed of a closed loop.

    Attributes:
        poles: eigenvalues of A + B K C_y [rad/s], complex, shape (n,).
        norm: the H-infinity norm by two routes, and where it peaks.
        bound: gamma = eta^-1/2 of the LMI; None for a gain that came without one.
        X: the matrix that proves the bound, shape (n, n); None without one.
        X_smallest: smallest eigenvalue of X, balanced to a unit diagonal.
        lmi_largest: largest eigenvalue of (20), balanced likewise. Negative proves stability and norm < bound.
        lmi_rounding: what rounding can add to it.
        speed_up: magnitude of the fastest pole, over that of the plant's fastest pole without control.
        norm_rounding: a norm below this is zero to rounding, and its routes need not agree.
        lower: what no controller of its kind can beat, with its proof; None where nobody asked.
    """

    poles: Array
    norm: Norm
    bound: float | None
    X: Array | None
    X_smallest: float
    lmi_largest: float
    lmi_rounding: float
    speed_up: float
    norm_rounding: float
    lower: LowerBound | None = None

    @property
    def gap(self) -> float | None:
        """How far the norm lies above the lower bound, relative; None without a bound, or without a finite norm."""
        if self.lower is None or self.lower.gamma == 0 or not np.isfinite(self.norm.value):
            return None
        return self.norm.value / self.lower.gamma - 1

    @property
    def stable(self) -> bool:
        """Whether all poles lie left of the imaginary axis."""
        return bool(np.all(np.real(self.poles) < 0))

    @property
    def beyond_actuators(self) -> bool:
        """Whether the gain asks for more speed than actuators have. That makes no proof wrong, and many a gain useless."""
        return self.speed_up > FASTEST

    @property
    def remarks(self) -> tuple[str, ...]:
        """What else there is to know, in words: no claim fails by it."""
        if not self.beyond_actuators:
            return ()
        return (
            f"beyond any actuator: a pole is {self.speed_up:.2g} times as fast as the plant's fastest without control; "
            f"{FASTEST:g} times is much",
        )

    @property
    def failures(self) -> tuple[str, ...]:
        """The claims that do not hold, in words; empty where all do."""
        failures = []
        if not self.stable:
            failures.append(f"unstable: a pole at {_pole(self.poles[np.argmax(np.real(self.poles))])} rad/s")
        elif self.norm.gap > ROUTES_AGREE and self.norm.value > self.norm_rounding:
            failures.append(f"the two routes to the norm differ by {self.norm.gap:.0e}")
        if self.bound is not None:
            if self.X_smallest <= 0:
                failures.append(f"X is not positive definite: balanced, its smallest eigenvalue is {self.X_smallest:.1e}")
            if self.lmi_largest > self.lmi_rounding:
                failures.append(
                    f"LMI (20) is violated: its largest eigenvalue is {self.lmi_largest:.1e}, rounding is {self.lmi_rounding:.0e}"
                )
            if self.norm.value > self.bound:
                failures.append(f"the norm {self.norm.value:.7g} exceeds the bound {self.bound:.7g}")
        if self.gap is not None and self.gap < -BELOW:
            failures.append(f"the norm {self.norm.value:.7g} lies below {self.lower.gamma:.7g}, which no controller can beat")  # pyright: ignore[reportOptionalMemberAccess]
        return tuple(failures)


def certify(
    plant: GeneralizedPlant, G: Array, X: Array | None = None, eta: float | None = None, lower: LowerBound | None = None
) -> Certificate:
    """Checks a gain, and its proof if it has one.

    Args:
        plant: n states, m inputs.
        G: state gain K C_y (6), shape (m, n).
        X: the matrix of (20), shape (n, n).
        eta: gamma^-2 of (20); given with X.
        lower: what no controller of the gain's kind can beat.
    """
    loop = plant.closed_loop(G)
    X_smallest = lmi_largest = lmi_rounding = float("nan")
    bound = None
    if X is not None and eta is not None:
        bound = float(eta**-0.5)
        # A congruence changes no sign of an eigenvalue: balanced to a unit diagonal of X, sizes mean something.
        diagonal = np.diagonal(X)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        balanced = loop.in_coordinates(np.diag(scale))
        unit = X / np.outer(scale, scale)
        X_smallest = float(np.linalg.eigvalsh(unit)[0])
        nothing = np.zeros_like(G)
        F = bounded_real_matrix(balanced, unit, nothing, eta)
        lmi_largest = float(np.linalg.eigvalsh(F)[-1])
        terms = np.linalg.norm(balanced.A, 2) * np.linalg.norm(unit, 2) + np.linalg.norm(F, 2)
        lmi_rounding = float(len(F) * np.finfo(float).eps * terms)
    poles = np.sort_complex(np.linalg.eigvals(loop.A))
    return Certificate(
        poles=poles,
        norm=hinf_norm(loop),
        bound=bound,
        X=X,
        X_smallest=X_smallest,
        lmi_largest=lmi_largest,
        lmi_rounding=lmi_rounding,
        speed_up=float(np.abs(poles).max() / (np.abs(np.linalg.eigvals(plant.A)).max() or 1.0)),
        norm_rounding=_norm_rounding(loop),
        lower=lower,
    )


def _norm_rounding(loop: GeneralizedPlant) -> float:
    """What rounding makes of a transfer function that is zero: the parts that are 0 are not quite."""
    A, scale = balance(loop.A)
    poles, vectors = np.linalg.eig(A)
    try:
        left = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:  # a double pole without a second eigenvector
        return 0.0
    passes = np.linalg.norm(loop.C * scale) * np.linalg.norm(loop.Bw / scale[:, None])
    size = np.linalg.norm(vectors, axis=0) * np.linalg.norm(left, axis=1) / np.maximum(-np.real(poles), 1e-300)
    return float(100 * np.finfo(float).eps * passes * size.sum()) if len(poles) else 0.0


def _pole(pole: complex) -> str:
    return f"{pole.real:.4g}" if pole.imag == 0 else f"{pole.real:.4g}{abs(pole.imag):+.4g}j"
