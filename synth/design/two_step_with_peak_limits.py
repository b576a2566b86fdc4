"""The two steps with hard limits: a gain whose signals stay within bounds for a disturbance of given energy.

1. (22) with the limits (`lmi/sdp.py`) gives X, and L (14).
2. (25) with the limits gives the gain.

**The solver proposes, the certificate decides.** Norm and peaks of the gain are proved without the solver. As one X has to serve
norm and peaks, a gain stays further within its limits than it has to: so the LMIs are also solved with limits that are looser by
some factors, and with none, and of all gains that stay within the limits asked for the one with the least norm is taken.
"""

from dataclasses import dataclass, field

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, quoted
from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import Certificate
from synth.analysis.energy_to_peak import EnergyPeaks, energy_peaks, signals
from synth.analysis.norm import hinf_norm
from synth.design.two_step import two_step_design
from synth.lmi.output_feedback import independent_rows, l_matrix, nullspace, r_matrix
from synth.lmi.sdp import LmiSolution, solve_limited
from synth.plant.generalized import Feedback, GeneralizedPlant, check_continuous, check_posed, measurement_matrix, real_matrix
from synth.plant.numerics import DesignError, InfeasibleError, numerics
from synth.plant.units import Scaled, own_units

LOOSER = (1.0, 1.1, 1.2, 1.4, 1.7, 2.0, 2.8, 4.0, 8.0, 16.0)  # times the limits, for the LMIs alone
HALVED = 4  # times the step between the loosest limits that led to the best gain and the next, that led to one beyond the limits
TIME = 3.0  # times the plant's own rate: the unit of time is one over it in which the LMIs are solved


@dataclass(frozen=True, eq=False)
class LimitedDesign:
    """A gain that keeps limits.

    Attributes:
        gain: K, shape (m, q).
        certificate: of the loop's norm.
        peaks: of the signals, for a disturbance of energy 1.
        looser: the factor of the limits in the LMIs that led to it; infinite for the paper's own two steps.
        redundant: rows of C_y that follow from others, by index; their gain is zero.
    """

    gain: Array
    certificate: Certificate
    peaks: EnergyPeaks
    looser: float
    redundant: tuple[int, ...]


@numerics()
def limited_design(plant: GeneralizedPlant, Cy: Array, Cs: Array, Ds: Array, most: Array) -> LimitedDesign:
    """The gain u = K y of least norm that the two steps find among those that keep the limits.

    Args:
        plant: continuous, n states, m inputs.
        Cy: what is measured, shape (q, n).
        Cs: what is limited, s = C_s x + D_s u, shape (p, n).
        Ds: shape (p, m).
        most: how far each may go for a disturbance whose square has the integral 1, above 0, shape (p,); for a road of energy E
            that is a limit in the signal's unit over E^1/2.

    Raises:
        InputError: the plant is discrete, or something does not fit it.
        InfeasibleError: no gain that the two steps found keeps the limits; the message says which is exceeded, and by how much.
        DesignError: the solver gave up.

    Example:
        >>> import numpy as np
        >>> from synth import GeneralizedPlant, limited_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> Cy, Cs, Ds = np.array([[0.0, 1.0]]), np.zeros((1, 2)), np.ones((1, 1))
        >>> design = limited_design(oscillator, Cy, Cs, Ds, most=np.array([0.5]))
        >>> design.gain.round(2)
        array([[-0.58]])
    """
    check_continuous(plant)
    check_posed(plant)
    Cy = measurement_matrix(Cy, len(plant.A))
    Cs, Ds = signals(plant, Cs, Ds)
    (limits,) = real_matrix([most], "the row of limits", f"(1, {len(Cs)}), a number above 0 for each signal")
    if len(limits) != len(Cs) or not np.all(limits > 0):
        raise InputError(f"limits {quoted(most)} for {len(Cs)} signals; give a finite number above 0 for each")
    kept = independent_rows(plant, Cy)
    tries = _Tries(plant, Cy, kept, _Steps(plant, Cy[kept], Cs, Ds), Cs, Ds, limits)
    for looser in (*LOOSER, np.inf):
        tries.add(looser)
    if tries.found and np.isfinite(low := min(tries.found, key=lambda one: one.norm).looser):
        high = min((looser for _, _, looser in tries.exceeded if low < looser < np.inf), default=low)
        for _ in range(HALVED):
            middle = (low * high) ** 0.5
            low, high = (middle, high) if tries.add(middle) else (low, middle)
    return tries.best()


@dataclass(frozen=True, eq=False)
class _Found:
    norm: float
    looser: float
    K: Array
    peaks: EnergyPeaks


@dataclass(eq=False)
class _Tries:
    """Gains that the LMIs led to with looser limits: those that keep the limits asked for, and what others exceed them by."""

    plant: GeneralizedPlant
    Cy: Array
    kept: list[int]
    steps: "_Steps"
    Cs: Array
    Ds: Array
    limits: Array
    found: list[_Found] = field(default_factory=list)
    exceeded: list[tuple[float, int, float]] = field(default_factory=list)  # how many times, which signal, and how much looser
    failures: list[DesignError] = field(default_factory=list)

    def add(self, looser: float) -> bool:
        """Whether limits that are looser by a factor lead to a gain that keeps those that are asked for."""
        K = np.zeros((self.plant.B.shape[1], len(self.Cy)))
        try:
            if np.isfinite(looser):
                K[:, self.kept] = self.steps.gain(looser * self.limits)
            else:
                K = two_step_design(self.plant, self.Cy).gain
            peaks = energy_peaks(self.plant, Feedback(K, self.Cy), self.Cs, self.Ds)
        except DesignError as error:
            self.failures.append(error)
            return False
        over = peaks.bounds / self.limits
        if over.max() > 1:
            self.exceeded.append((float(over.max()), int(over.argmax()), looser))
            return False
        norm = hinf_norm(self.plant.closed_loop(Feedback(K, self.Cy))).value
        self.found.append(_Found(norm, looser, K, peaks))
        return True

    def best(self) -> LimitedDesign:
        """Of those that keep the limits, and whose certificate holds, the one of least norm; one within actuators before others.

        Raises:
            InfeasibleError, DesignError: as `limited_design`.
        """
        beyond: list[LimitedDesign] = []
        redundant = tuple(i for i in range(len(self.Cy)) if i not in self.kept)
        for one in sorted(self.found, key=lambda one: one.norm):
            certificate = certify_tightly(self.plant, Feedback(one.K, self.Cy))
            if certificate.failures:
                self.failures.append(DesignError(f"its certificate fails: {certificate.failures[0]}"))
                continue
            design = LimitedDesign(one.K, certificate, one.peaks, one.looser, redundant)
            if not certificate.beyond_actuators:
                return design
            beyond.append(design)
        if beyond:
            return beyond[0]
        if self.exceeded:
            over, which, _ = min(self.exceeded)
            raise InfeasibleError(
                f"no gain that the two steps found keeps the limits: of the nearest, signal {which} goes {over:.4g} times as far "
                f"as it may, {over * self.limits[which]:.4g} for a disturbance of energy 1; allow it more"
            )
        raise self.failures[0]


class _Steps:
    """Both steps in the plant's own units."""

    def __init__(self, plant: GeneralizedPlant, Cy: Array, Cs: Array, Ds: Array) -> None:
        units = own_units(plant, Cy)
        self.rate, self.inputs, self.own = units.rate, units.inputs, units.into(plant)
        self.Cy, self.measured = units.rows(Cy)
        self.Cs, self.Ds = Cs * units.states, Ds * units.inputs

    def gain(self, most: Array) -> Array:
        """K in the given units, shape (m, q).

        Raises:
            InfeasibleError, DesignError: as `solve_limited`.
        """
        n, q = len(self.own.A), len(self.Cy)
        eye, Q = np.eye(n), nullspace(self.Cy)
        first, scaled = self.solved(eye[:, :0], eye, most)
        X = scaled.T @ first.X @ scaled.T.T
        R = r_matrix(self.Cy, Q, l_matrix(X, self.Cy, Q))
        second, scaled = self.solved(Q, R, most)
        X_R, Y_R = second.X[-q:, -q:], second.Y[:, -q:]
        K = scaled.force * np.linalg.solve(X_R, Y_R.T).T @ np.linalg.inv(scaled.measured)
        return self.inputs[:, None] * K @ np.linalg.inv(self.measured)

    def solved(self, Q: Array, R: Array, most: Array) -> tuple[LmiSolution, Scaled]:
        """The solution in the coordinates of [Q R] and units in which all numbers have size one, and these."""
        a, eye = Q.shape[1], np.eye(len(self.own.A))
        scaled = Scaled([self.own], TIME * self.rate, Q, R, np.ones((R.shape[1], R.shape[1])))
        # Of w in its unit d and time in 1 / rate the integral of w^2 counts d^2 / rate.
        limits = (most * scaled.disturbance / scaled.rate**0.5)[:, None]
        rows, through = self.Cs @ scaled.T / limits, self.Ds * scaled.force / limits
        return solve_limited(scaled.plants[0], eye[:, :a], eye[:, a:], rows, through), scaled
