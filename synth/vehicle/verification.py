"""Verification that a gain satisfies its design goals; the verification does not depend on the search that found the gain."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from models.common.arrays import Array
from models.document.field import Field
from models.laws.goals import DecayBound, EnergyBound, GainBound, Goals, NormBound, NormOf, PeakBound
from models.laws.linear import static_law
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.band_norm import norm_in_band
from synth.analysis.energy_to_peak import energy_peaks
from synth.analysis.specification import FREQUENCY, Specification
from synth.analysis.stability import stability
from synth.design.descent.landscape import EVERYWHERE
from synth.design.multi_objective.band_filter import in_band
from synth.design.multi_objective.peak import peak_over_road
from synth.design.multi_objective.problem import GainErrors, MultiObjectiveProblem, NormSpecification
from synth.design.multi_objective.worst_case import worst_of_norm
from synth.design.uncertainty.multipliers import NEAR, bound_in_band, stable_in_box
from synth.design.uncertainty.problem import box_of, scaled_gain
from synth.design.uncertainty.worst_case import Proof, WorstNorm, stable_with_errors, worst_norm
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError

CLOSE = 1e-3  # relative gap between the bound in a band and the largest gain found, below which no other proof is tried
ERROR = Field[float]("error", float, "+.3g", 100, unit="%")
TIME = Field[float]("time", float, ".4g", unit="s")


@dataclass(frozen=True, eq=False)
class Verification:
    """Verification that one gain satisfies the goals in its section of the vehicle file.

    Attributes:
        vehicle, entry, goals: vehicle, controller's section of the vehicle file, and goals in this section.
        problem: optimisation problem that the goals define, stated with the plants of the vehicles.
        K: gain that is verified, shape (m, q).
        known: worst norms over all gain errors, which are stored so that each norm is computed only once.
    """

    vehicle: Vehicle
    entry: ControllerEntry
    goals: Goals
    problem: MultiObjectiveProblem
    K: Array
    known: dict[NormSpecification, list[WorstNorm]] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Text that describes each vehicle of the family; a single empty text if there is no family."""
        factors = [" and ".join(f"{name} x {by:g}" for name, by in member.items()) for member in self.goals.family]
        return [f"vehicle {i}, {text or 'unchanged'}" for i, text in enumerate(factors)] or [""]

    def promises(self) -> tuple[Specification, ...]:
        """Returns all specifications, beginning with the specifications of the minimised norm."""
        problem, goals = self.problem, self.goals
        specifications = [*self.largest(goals.minimise, problem.minimise)]
        if problem.bests is not None:
            specifications.append(self.regret(problem.bests))
        norms, signals, peak = iter(problem.norms), itertools.count(), 0
        for bound in goals.bounds:
            if isinstance(bound, NormBound):
                specifications += self.largest(bound, next(norms), bound.norm)
            elif isinstance(bound, DecayBound):
                specifications += self.decay(bound.decay)
            elif isinstance(bound, GainBound):
                specifications.append(Specification("largest entry of the gain", float(np.abs(self.K).max()), at_most=bound.gain))
            elif isinstance(bound, EnergyBound):
                specifications.append(self.energy_peak(bound, next(signals)))
            else:
                specifications.append(self.peak(bound, peak))
                peak += 1
        if goals.structure is not None:
            outside = np.abs(self.K[~problem.structure])
            specifications.append(
                Specification("entries of the gain outside its structure", float(outside.max(initial=0.0)), at_most=0.0)
            )
        return tuple(specifications)

    def largest(self, norm: NormOf, spec: NormSpecification, at_most: float | None = None) -> list[Specification]:
        """Returns the specifications of a norm over the family: first without gain errors, then for the worst gain errors, if
        any.
        """
        of = [_norm(member.plants[spec.which], self.K, spec) for member in self.problem.members]
        what = norm.text if len(of) == 1 else f"largest {norm.text} of {len(of)} vehicles"
        at = [f"at {FREQUENCY.text(at)}" if np.isfinite(at) else "" for _, _, at in of]
        alone = self.most(what, [each[:2] for each in of], None if self.problem.has_errors else at_most, at=at)
        if not self.problem.has_errors:
            return [alone]
        wholes, names = self.worst(spec), (*self.entry.measured, *self.vehicle.linear_model.inputs)
        off = [zip(names, (*each.readings, *each.forces), strict=True) for each in wholes]
        at = [", ".join(f"{name} {ERROR.text(error)}" for name, error in errors if error) for errors in off]
        of = [(each.found, each.proved) for each in wholes]
        return [alone, self.most(f"{what}, with errors", of, at_most, at=at, proofs=[each.proof for each in wholes])]

    def most(
        self,
        what: str,
        of: Sequence[tuple[float, float]],
        at_most: float | None = None,
        unit: str = "",
        at: Sequence[str] = (),
        proofs: Sequence[Proof | None] = (),
    ) -> Specification:
        """Returns the specification for the largest value of a quantity among the vehicles of the family.

        Args:
            what: name of the quantity that the specification describes.
            of: value of the quantity for each vehicle, with a proved upper bound.
            at_most: largest allowed value of the quantity; None if the quantity is minimised.
            unit: unit of the values and of `at_most`.
            at: text that states where each value occurs, for example at which frequency; may be empty.
            proofs: proof of each bound for all gain errors; empty if there are no gain errors.
        """
        i = int(np.argmax([value for value, _ in of]))
        where = ", ".join(filter(None, (self.names[i], at[i] if at else "")))
        how = " and ".join(sorted({proof.kind for proof in proofs if proof is not None}))
        return Specification(what, of[i][0], max(proved for _, proved in of), at_most, unit, where, how)

    def regret(self, bests: Sequence[float]) -> Specification:
        """Returns the specification of the largest ratio between a vehicle's norm and the individual optimum for this vehicle."""
        problem, proofs = self.problem, []
        if problem.has_errors:
            worst = self.worst(problem.minimise)
            of, proofs = [(each.found, each.proved) for each in worst], [each.proof for each in worst]
        else:
            of = [_norm(member.plants[0], self.K, problem.minimise)[:2] for member in problem.members]
        with_errors = ", with errors" if problem.has_errors else ""
        ratios = [(value / best, proved / best) for (value, proved), best in zip(of, bests, strict=True)]
        return self.most(f"largest ratio to a vehicle's own best{with_errors}", ratios, proofs=proofs)

    def worst(self, spec: NormSpecification) -> list[WorstNorm]:
        """Returns, for every vehicle, the norm for the worst gain errors."""
        if spec not in self.known:
            members = range(len(self.problem.members))
            self.known[spec] = [
                self.worst_of(i, spec) if spec.band == EVERYWHERE else self.worst_in_band(i, spec) for i in members
            ]
        return self.known[spec]

    def worst_of(self, i: int, spec: NormSpecification) -> WorstNorm:
        """Returns the norm of a vehicle for the worst gain errors, over all frequencies or with a band filter."""
        tolerance, enough = self.problem.tolerance, spec.at_most if np.isfinite(spec.at_most) else None
        problem = in_band(self.problem.members[i].plants[spec.which], spec.band)
        return worst_norm(problem, None, self.K, tolerance.sensors, tolerance.forces, enough=enough)

    def worst_in_band(self, i: int, spec: NormSpecification) -> WorstNorm:
        """Returns the norm of a vehicle in a band for the worst gain errors.

        The bound is proved by multipliers or, if this method fails, with a band filter.
        """
        problem, tolerance = self.problem.members[i].plants[spec.which], self.problem.tolerance
        best = self.problem.bests[i] if spec is self.problem.minimise and self.problem.bests is not None else 1.0
        tried = [worst_of_norm(self.problem, i, spec, best, self.K)[1], self.problem.no_errors]
        unit = max(_norm(each.on(problem), self.K, spec)[0] for each in tried)
        gain, proof = scaled_gain(problem, self.K), None
        box = box_of(gain, tolerance.sensors, tolerance.forces)
        if problem.dt is None and stable_in_box(gain, box) is not None:
            proof = bound_in_band(gain, box, *spec.band, unit * (1 + NEAR))
        # the norm with the filter is at least the norm in the band
        if proof is None or proof.bound > unit * (1 + CLOSE):
            behind = self.worst_of(i, spec)
            tried = [GainErrors(behind.readings, behind.forces), *tried]
            if proof is None or behind.proved < proof.bound:
                proof = behind.proof
        values = [_norm(each.on(problem), self.K, spec)[0] for each in tried]
        worst = tried[int(np.argmax(values))]
        return WorstNorm(max(values), worst.sensors, worst.forces, proof.bound if proof is not None else np.inf, proof)

    def decay(self, rate: float) -> list[Specification]:
        """Returns the specifications of the slowest pole in the family: first without gain errors, then with gain errors, if
        any.

        To prove the decay rate with gain errors, all poles are shifted to the right by `rate`. The decay rate is proved if the
        loops with shifted poles are stable for all gain errors.
        """
        slowest = [_slowest(member.plants[0], self.K) for member in self.problem.members]
        i = int(np.argmax(slowest))
        specifications = [Specification("slowest pole", slowest[i], at_most=-rate, unit="rad/s", where=self.names[i])]
        if not self.problem.has_errors:
            return specifications
        rates, proofs, tolerance = [], list[Proof | None](), self.problem.tolerance
        for i, member in enumerate(self.problem.members):
            beyond, errors = worst_of_norm(self.problem, i, None, rate, self.K)
            rates.append(max(_slowest(errors.on(member.plants[0]), self.K), slowest[i]))
            moved = shifted_plant(member.plants[0], rate)
            proofs.append(stable_with_errors(moved, self.K, tolerance.sensors, tolerance.forces) if beyond < 1 else None)
        of = [(each, -rate if proof is not None else np.inf) for each, proof in zip(rates, proofs, strict=True)]
        return [*specifications, self.most("slowest pole, with errors", of, -rate, "rad/s", proofs=proofs)]

    def energy_peak(self, bound: EnergyBound, which: int) -> Specification:
        """Returns the specification of a signal's largest magnitude over all roads up to the energy that the bound states."""
        of = []
        for member in self.problem.members:
            problem, signal = member.plants[self.problem.minimise.which], member.signals[which]
            try:
                peaks = energy_peaks(problem, problem.acting(self.K) @ problem.Cy, signal.c[None], signal.g[None])
                of.append((signal.root * float(peaks.peaks[0]), signal.root * float(peaks.bounds[0])))
            except DesignError:  # the loop is not stable
                of.append((np.inf, np.inf))
        what = f"largest {bound.energy_peak} for roads of {bound.energy:g} m2/s"
        return self.most(what, of, bound.at_most, self.vehicle.kind.signal(bound.energy_peak).unit)

    def peak(self, bound: PeakBound, which: int) -> Specification:
        """Returns the specification of the largest magnitude of a signal while the vehicle drives over one road."""
        of = [peak_over_road(member.driven_by[which], self.K) for member in self.problem.members]
        at = [f"{TIME.text(peak.time)} after its start" for peak in of]
        values, unit = [(peak.value, peak.proved) for peak in of], self.vehicle.kind.signal(bound.peak).unit
        return self.most(f"largest {bound.peak} over {bound.road}", values, bound.at_most, unit, at)


def _norm(plant: Plant, K: Array, spec: NormSpecification) -> tuple[float, float, float]:
    """Returns the norm in the frequency band, a proved bound on the norm, and the peak frequency [rad/s]; infinite if the loop
    is unstable.
    """
    norm = norm_in_band(_loop(plant, K), *spec.band)
    if not norm.stability.stable:
        return np.inf, np.inf, np.nan
    return norm.value, norm.level, norm.peak_frequency


def shifted_plant(plant: Plant, rate: float) -> Plant:
    """Returns the plant without weighting filters, and with all poles shifted to the right by `rate`.

    A loop with the shifted plant is stable if the loop with the original plant decays faster than `rate` [1/s].
    """
    alone = plant.without_weighting
    return replace(alone, A=alone.A + rate * np.eye(len(alone.A)))


def _slowest(plant: Plant, K: Array) -> float:
    """Returns the largest real part of the poles of a loop [1/s], excluding the poles of filters."""
    own = len(plant.A) - plant.weights
    return max(float(np.real(pole)) for pole in stability(_loop(plant, K).A[:own, :own]).poles)


def _loop(plant: Plant, K: Array) -> Plant:
    return plant.closed(static_law(K))
