"""Certificates of gains by the Bounded Real Lemma.

Certificates are computed only with numpy, without the solver that found the gains.

For a closed loop, the lemma is LMI (20) of the paper; for a design, which determines the gain, the lemma is LMI (21). With a
feedthrough Dw from w to z (zero in the paper), the Schur complement that leads to (20) gives

    [ A X + X A' + B Y + Y' B' + eta Bw Bw'    *                  ]
    [ C X + D Y + eta Dw Bw'                   -I + eta Dw Dw'    ]  < 0,

which is affine in X, Y and eta = gamma^-2.

For a discrete closed loop, the inequality of the lemma is

    [ A X A' - X + eta Bw Bw'    A X C' + eta Bw Dw'       ]
    [ *                          C X C' - I + eta Dw Dw'   ]  < 0,

which is not affine in a gain. A design therefore uses a larger matrix, whose Schur complement is the matrix of the discrete
inequality. For the larger matrix, the plant is written in differences over the sample period T (`Plant.differences`), and X T
replaces X. The larger matrix then consists of the matrix for a continuous plant and additional rows and columns:

    [ He(A X + B Y) + eta Bw Bw'          *                 *   ]
    [ C X + D Y + eta Dw Bw'              -I + eta Dw Dw'   *   ]
    [ sqrt(T) (A X + B Y)'        sqrt(T) (C X + D Y)'     -X   ]  < 0.

As T decreases, the entries of the matrix for the discrete plant approach the entries of the matrix for the continuous plant.
The larger matrix loses no digits by cancellation, even at a sample rate of 1 kHz.

The LMI is *proved* in exact arithmetic (`analysis/rigorous.py`): all floats in the matrices are taken as exact numbers. The
proof shows that the loop A + B G is stable and that its norm is below the bound. The norm itself is computed by two different
methods.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import Must, accept_former_names, check_shape
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.printed import about, difference, digits, magnitude
from models.document.document import Document
from models.document.text import ShownResult, facts
from synth.analysis.norm import Norm, hinf_norm
from synth.analysis.rigorous import SMALLEST, Definiteness, definiteness, floats, integers, product, zeros
from synth.analysis.stability import Stability, balance, beside_weights, stability
from synth.plant.generalized import Feedback, Plant, check_states
from synth.plant.numerics import numerics
from synth.plant.units import speed

if TYPE_CHECKING:
    from models.document.figure import Figure
    from synth.analysis.lower_bounds.lower_bound import LowerBound


# The module of the class LowerBound is imported only where the class is used.
_BOUND = "a lower bound, such as synth.find_lower_bound returns or None"
KnownBound = Annotated[
    "LowerBound | None", Must(_BOUND, lambda one: one is None or type(one).__name__ in ("LowerBound", "LaterBound"))
]


def bounded_real_matrix(plant: Plant, X: Array, Y: Array, eta: float, step: float = 0.0) -> Array:
    """Returns the matrix on the left side of (21), shape (n + d, n + d). For Y = 0, the matrix of (21) is the matrix of (20).

    Args:
        plant: plant with n states, m inputs and d outputs z.
        X: symmetric matrix, shape (n, n).
        Y: matrix of shape (m, n).
        eta: gamma^-2.
        step: sample period of a plant that is written in differences (`Plant.differences`) [s]; 0 for a continuous plant. If
            the step is not 0, the matrix has n more rows and n more columns.
    """
    top = plant.A @ X + plant.B @ Y
    low = plant.C @ X + plant.D @ Y
    disturbance = np.vstack([plant.Bw, plant.Dw])
    d = len(plant.C)
    F = np.block([[top + top.T, low.T], [low, -np.eye(d)]]) + eta * disturbance @ disturbance.T
    if not step:
        return F
    border = step**0.5 * np.vstack([top, low])
    return np.block([[F, border], [border.T, -X]])


def bounded_real_exactly(plant: Plant, G: Array | Feedback, X: Array, eta: float) -> Array:
    """Returns the left side of LMI (20), or of its discrete form, for the loop A + B G, C + D G.

    The matrix of the inequality is computed exactly. Each entry of the exact matrix is then rounded once.

    Args:
        plant: plant with n states and m inputs.
        G: state gain, shape (m, n), or a gain from measurements.
        X: symmetric matrix, shape (n, n).
        eta: gamma^-2.

    Raises:
        OverflowError: an entry is too large for a float.
    """
    n, m = plant.B.shape
    (system, of_plant), (gain, of_gain), (whole, of_X) = integers(plant.system_matrix), _gain(G), integers(X)
    eta_top, eta_bottom = float(eta).as_integer_ratio()
    # The variables `of_...` and `over_...` are common denominators: of a matrix, or of the terms that contain X or eta
    of_loop = of_plant * of_gain
    loop = system[:, :n] * of_gain + product(system[:, n : n + m], gain)
    F = product(loop, whole)
    if plant.dt is None:
        over_X, half = of_loop * of_X, zeros(len(system), len(system))
        half[:, :n] = F
        F = half + half.T
    else:
        over_X = of_loop**2 * of_X
        F = product(F, loop.T)
        F[:n, :n] -= whole * of_loop**2
    F[np.arange(n, len(F)), np.arange(n, len(F))] -= over_X
    over_eta, from_w = eta_bottom * of_plant**2, system[:, n + m :]
    return floats(F * over_eta + eta_top * over_X * product(from_w, from_w.T), Fraction(1, over_X * over_eta))


def _gain(G: Array | Feedback) -> tuple[Array, int]:
    """Returns the state gain as a matrix of integers and a common denominator, in the format of the function `integers`."""
    if not isinstance(G, Feedback):
        return integers(G)
    (gain, of_gain), (rows, of_rows) = integers(G.K), integers(G.Cy)
    return product(gain, rows), of_gain * of_rows


# a warning is printed if the fastest pole of the loop exceeds this multiple of the plant's speed, because the loop then needs
# unusually fast actuators
FASTEST = 100.0
# slowest useful decay rate, as a multiple of the plant's speed; if the plant moves within 1 s, such a decay takes 100 days
SLOWEST = 1e-7
BELOW = 1e-9  # relative amount by which rounding may put a computed norm below its lower bound
# allowed relative difference between the norms that the two methods compute; about 1e-12 for a well-conditioned plant
ROUTES_AGREE = 1e-6
# Allowed relative difference between the norm and the gain at the claimed peak frequency. This frequency may be inexact,
# because the gain is flat near a peak.
PEAKS_AGREE = 1e-9


@dataclass(frozen=True, eq=False)
class LmiProof:
    """Proof of a bound: X > 0 and LMI (20) < 0, or the discrete form of (20) (see the docstring of the module `certificate.py`).

    Attributes:
        X: symmetric matrix, shape (n, n).
        eta: gamma^-2.
        positive: result of the check whether X is positive definite.
        negative: result of the check that the left side of (20), multiplied by -1, is positive definite.
    """

    X: Array
    eta: float
    positive: Definiteness
    negative: Definiteness

    @property
    def holds(self) -> bool:
        """True if both inequalities, X > 0 and (20), are proved."""
        return self.positive.proved and self.negative.proved

    @property
    def bound(self) -> float:
        """Proved bound gamma = eta^-1/2 on the norm, rounded up."""
        return bound_of(self.eta)

    @property
    def failures(self) -> tuple[str, ...]:
        """Descriptions of the inequalities that are not proved."""
        failures = []
        if not self.positive.proved:
            failures.append(_not_proved("X is not positive definite", "X > 0 is not proved", "smallest", 1, self.positive))
        if not self.negative.proved:
            failures.append(
                _not_proved("LMI (20) is not negative definite", "LMI (20) is not proved", "largest", -1, self.negative)
            )
        return tuple(failures)


def _not_proved(false: str, open_: str, which: str, sign: int, definiteness: Definiteness) -> str:
    """Returns a text that explains why an inequality could not be proved."""
    if np.isnan(definiteness.smallest):
        return f"{false}: a diagonal entry has the wrong sign, or the magnitude of an entry exceeds 1e200"
    if definiteness.smallest <= 0:
        return f"{false}: after balancing, its {which} eigenvalue is {difference(sign * definiteness.smallest)}"
    needed = f"{'above' if sign > 0 else 'below'} {magnitude(sign * definiteness.rounding)}"
    smallest = difference(sign * definiteness.smallest)
    return f"{open_}: after balancing, its {which} eigenvalue is {smallest}; a proof needs a value {needed}"


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(ShownResult):
    """Stability, norm and bounds of a closed loop, together with the proofs of these results.

    Attributes:
        loop: closed loop to which all results of the certificate apply.
        stability: poles of the loop, and whether they are stable.
        own: stability of the loop without the poles of the filters of z and w, because no controller can change these poles.
        norm: H-infinity norm, computed by two methods, and the frequency at which the gain has its peak.
        proof: proof of an upper bound on the norm; None if no upper bound is known.
        speed_up: magnitude of the fastest pole of `own`, divided by the speed of the plant without control.
        moves: True if the plant has poles other than 0; the speed of the plant is then the magnitude of the fastest pole of the
            plant. If all poles are at 0, the speed is the rate at which motion and driving force have equal weight in z
            (`units.own_units`).
        norm_rounding: threshold below which the norm counts as zero, so that the results of the two methods need not agree.
        below: lower bound on the norm for all controllers with the same measurements, with its proof; None if the bound was not
            requested.
    """

    public_name = "a certificate, such as synth.certify returns"

    loop: Plant
    stability: Stability
    own: Stability
    norm: Norm
    proof: LmiProof | None
    speed_up: float
    moves: bool
    norm_rounding: float
    below: "LowerBound | None" = None

    @property
    def summary(self) -> Document:
        """Document with the norm, the proved bound, the lower bound, and those claims that do not hold."""
        return facts(f"certificate: {'FAILS' if self.failures else 'holds'}", self.claims)

    @property
    def claims(self) -> dict[str, str]:
        """Norm, bound and lower bound as texts, and the claims that do not hold; the text of a missing value is empty."""
        known = {"norm": self.norm.value, "bound": self.bound, "lower bound": self.lower_bound}
        texts = {name: "" if value is None else digits(value) for name, value in known.items()}
        return texts | {"failures": "; ".join(self.failures)}

    @property
    def figures(self) -> "tuple[Figure, ...]":
        """Figure of the closed loop's gain against frequency, with the bound and the lower bound."""

        loop, levels = self.loop, {"bound": self.bound, "lower bound": self.lower_bound}
        title = "Largest singular value of the closed loop, from w to z."
        return (FEATURES.load("figures in notebooks").gain_figure(title, loop.A, loop.Bw, loop.C, loop.Dw, loop.dt, levels),)

    @property
    def bound(self) -> float | None:
        """Bound gamma that the LMI proves; None if the LMI is not proved."""
        return self.proof.bound if self.proof is not None else None

    @property
    def lower_bound(self) -> float | None:
        """Lower bound on the norm for all controllers with the same measurements; None if no bound above 0 is proved."""
        return (self.below.gamma or None) if self.below is not None else None

    @property
    def poles(self) -> Array:
        """Eigenvalues of A + B K C_y [rad/s], complex, shape (n,); for a discrete loop, the poles z [-]."""
        return self.stability.poles

    @property
    def stable(self) -> bool:
        """True if no pole is unstable or so close to the stability limit that rounding could hide an unstable pole."""
        return self.stability.stable

    @property
    def gap(self) -> float | None:
        """Relative gap between the norm and the lower bound; None if there is no lower bound, or if the norm is infinite."""
        if self.lower_bound is None or not np.isfinite(self.norm.value):
            return None
        return self.norm.value / self.lower_bound - 1

    @property
    def beyond_actuators(self) -> bool:
        """True if the loop is too fast for real actuators. The proofs remain valid, but the gain may be useless in practice."""
        return self.speed_up > FASTEST

    @property
    def hardly_decays(self) -> bool:
        """True if the loop is stable but has a mode that hardly decays. The proofs remain valid for such a loop."""
        return self.own.stable and -float(self.own.growth.max(initial=-np.inf)) < SLOWEST * self.speed * (self.loop.dt or 1.0)

    @property
    def speed(self) -> float:
        """Speed of the plant without control [rad/s]; `speed_up` is relative to this speed."""
        return float(self.own.rates.max(initial=0.0)) / self.speed_up if self.speed_up else 0.0

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings about the loop; the claims of the certificate are valid despite these warnings."""
        remarks = []
        if self.hardly_decays:
            rate = -float(self.own.growth.max()) / (self.loop.dt or 1.0)
            remarks.append(
                f"the loop is hardly stable: a pole decays at only {about(rate)} 1/s, {magnitude(rate / self.speed)} times the "
                "typical rate of the plant; weight or measure the signal that this pole moves"
            )
        if self.beyond_actuators:
            than = (
                "the fastest pole of the plant without control"
                if self.moves
                else "the rate at which motion and force have equal weight in z (all poles of the plant are at 0)"
            )
            remarks.append(
                f"too fast for actuators: a pole is {about(self.speed_up)} times as fast as {than}; the limit is {FASTEST:g}"
            )
        return tuple(remarks)

    @property
    def failures(self) -> tuple[str, ...]:
        """Descriptions of those claims that do not hold; empty if all claims hold."""
        if self.gap is None or self.gap >= -BELOW:
            return self.loop_failures
        below = f"the norm {digits(self.norm.value)} is below the lower bound {digits(self.lower_bound)}"
        return (*self.loop_failures, below)

    @property
    def loop_failures(self) -> tuple[str, ...]:
        """Descriptions of those claims about the loop itself that do not hold; the list does not consider the lower bound."""
        failures = []
        if not self.stable:
            failures.append(self.stability.words)
        elif self.norm.value > self.norm_rounding and self.norm.rounding > ROUTES_AGREE:
            failures.append(
                f"rounding may change the norm by {magnitude(self.norm.rounding)}: the loop is too close to marginal stability"
            )
        elif self.norm.value > self.norm_rounding and self.norm.gap > ROUTES_AGREE:
            failures.append(f"two independent computations of the norm differ by {magnitude(self.norm.gap)} of its value")
        if self.proof is not None:
            failures += self.proof.failures
            if self.norm.value > self.proof.bound:
                failures.append(f"the norm {digits(self.norm.value)} exceeds the bound {digits(self.proof.bound)}")
        return tuple(failures)

    def peaks_at(self, omega: float) -> bool:
        """Returns True if the gain at the frequency omega [rad/s] equals the norm, up to the allowed difference.

        The gain is flat at a peak, so the relative accuracy of a peak frequency is only about 1e-5.
        """
        if not np.isfinite(self.norm.value):
            return False
        there = FEATURES.load("norms with twice the precision").gain_at(self.loop, omega)
        allowed = PEAKS_AGREE * self.norm.value if self.norm.value > self.norm_rounding else self.norm_rounding
        return abs(there - self.norm.value) <= allowed


@accept_former_names(by_itself="plant_without_law")
@numerics()
def certify(
    plant: Plant,
    G: Array | Feedback,
    X: Array | None = None,
    eta: float | None = None,
    lower_bound: KnownBound = None,
    plant_without_law: Plant | None = None,
) -> Certificate:
    """Computes the certificate of a gain. If X and eta are given, checks whether X and eta prove a bound.

    X and eta can come from an LMI solution or from a design record. Without X and eta, the certificate contains no bound.
    `certify_tightly` computes X and eta itself, but takes several times as long.

    Args:
        plant: plant with n states and m inputs.
        G: gain from the measurements, as in (6) of the paper, which is used without rounding; or a state gain of shape (m, n).
        X: symmetric matrix X of LMI (20), shape (n, n).
        eta: value gamma^-2 of (20), required if X is given.
        lower_bound: lower bound on the norm for all controllers with the same measurements as G.
        plant_without_law: plant without the states of the controller. `Certificate.speed_up` is relative to the speed of
            `plant_without_law`. The attribute `weights` of `plant_without_law` is the number of states that belong to filters.
            Default: `plant`.

    Returns:
        Stability, H-infinity norm, and, if X and eta are given, the proof of the bound eta^-1/2, as a `Certificate`. The
        `failures` of the certificate list the claims that do not hold.

    Raises:
        InputError: eta or X is outside the allowed range, or X has the wrong shape.

    Example:
        >>> from synth import GeneralizedPlant, Feedback, certify
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> certificate = certify(oscillator, Feedback(K=[[-2.0]], Cy=[[0, 1]]))
        >>> certificate.stable, f"{certificate.norm.value:.4f}"
        (True, '0.2903')
    """
    check_states(len(plant.A))
    if X is not None:
        check_shape("X", X, plant.A.shape, "a row and a column for each state of the plant")
    loop = plant.closed_loop(G)
    base = plant_without_law or plant
    loop_stability, norm, (fastest, moves) = stability(loop.A, loop.dt), hinf_norm(loop), speed(base)
    own = stability(beside_weights(base, loop.A), loop.dt) if base.weights else loop_stability
    return Certificate(
        loop=loop,
        stability=loop_stability,
        own=own,
        norm=norm,
        proof=prove_bound(plant, G, X, eta) if X is not None and eta is not None else None,
        speed_up=float(own.rates.max()) / fastest,
        moves=moves,
        norm_rounding=_norm_rounding(loop, norm.peak_frequency) if loop_stability.stable else 0.0,
        below=lower_bound,
    )


def prove_bound(plant: Plant, G: Array | Feedback, X: Array, eta: float) -> LmiProof:
    """Checks whether X and eta satisfy X > 0 and (20) for the loop A + B G, C + D G.

    The matrix of (20) (see the docstring of the module `certificate.py`) is computed without rounding from X, eta, the plant
    and the gain.

    Args:
        plant: plant with n states and m inputs.
        G: state gain, shape (m, n), or a gain from measurements.
        X: matrix of shape (n, n), of which only the symmetric part is used.
        eta: gamma^-2.

    Raises:
        InputError: eta or X is outside the allowed range.
    """
    X = (X + X.T) / 2
    try:
        if not (SMALLEST <= eta <= 1 / SMALLEST and np.all(np.abs(X) <= 1 / SMALLEST)):
            raise OverflowError
        negative = -bounded_real_exactly(plant, G, X, eta)
    except OverflowError:
        raise InputError(
            f"eta = {eta:g} is out of the allowed range, or the largest entry of X, which is "
            f"{np.abs(X).max(initial=0.0):g}, is too large; give an eta from {SMALLEST:g} to {1 / SMALLEST:g}, and entries of X "
            f"of at most {1 / SMALLEST:g}"
        ) from None
    return LmiProof(X, eta, definiteness(X), definiteness(negative))


def eta_of(bound: float) -> float:
    """Returns eta = gamma^-2 for a bound gamma, rounded up. A proof for the rounded eta proves the bound gamma, or a bound just
    below gamma.
    """
    eta = bound**-2
    while Fraction(bound) ** 2 * Fraction(eta) < 1:
        eta = float(np.nextafter(eta, np.inf))
    return eta


def bound_of(eta: float) -> float:
    """Returns the bound gamma = eta^-1/2, rounded up."""
    bound = float(eta**-0.5)
    while Fraction(bound) ** 2 * Fraction(eta) < 1:
        bound = float(np.nextafter(bound, np.inf))
    return bound


def _norm_rounding(loop: Plant, at: float) -> float:
    """Returns the largest gain that rounding errors can produce at the frequencies 0 and `at` [rad/s] if the true gain is 0."""
    A, scale = balance(loop.A)
    points = 1j * np.array([0.0, at if np.isfinite(at) else 0.0])
    points = points if loop.dt is None else np.exp(points * loop.dt)
    R = np.abs(np.linalg.inv(points[:, None, None] * np.eye(len(A)) - A))
    passes = np.abs(loop.C * scale) @ R @ np.abs(loop.Bw / scale[:, None])
    return float(100 * np.finfo(float).eps * np.linalg.norm(passes, axis=(1, 2)).max(initial=0.0))


class LaterBound:
    """A `LowerBound` whose proof is computed only when one of its attributes is first read.

    If the object is sent to a worker process, the proof is computed before the object is sent.
    """

    def __init__(self, prove: Callable[[], Any]) -> None:
        self._prove = prove

    @cached_property
    def _proved(self) -> Any:
        return self._prove()

    def __getattr__(self, name: str) -> Any:
        """Returns the attribute `name` of the proved bound."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._proved, name)

    def __reduce__(self) -> tuple[Callable[[Any], Any], tuple[Any]]:
        return return_bound, (self._proved,)


def return_bound(bound: Any) -> Any:
    """Returns its argument unchanged. Pickle uses this function to restore a `LaterBound` object."""
    return bound
