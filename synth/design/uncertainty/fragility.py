"""Fragility of a law: the errors of measurements, forces and coefficients that the loop tolerates, and the effect of these
errors on the norm.

Each margin has two limits: a box of errors for which the property is proved, and errors for which the property fails. If there
is one force, an error of this force has the same effect as equal errors of all measurements. If there are several forces, each
force also has its own error.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import digits, percent
from models.document.field import Record
from models.laws.linear import LinearLaw
from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import Certificate
from synth.analysis.uncertainty_box import Box, ScaledGain
from synth.design.uncertainty.problem import box_of, errors_of
from synth.design.uncertainty.worst_case import WorstCaseNormFunction, local_maximum, prove_bound, vertex_search
from synth.plant.generalized import Feedback, Plant
from synth.plant.numerics import numerics

INT16 = 2**15 - 1  # largest integer of the format int16
# a matrix with an entry above this limit is divided by the smallest power of two that brings all entries below the limit
FLOAT16 = 2.0**15
FORMATS = ("int16", "float16")


def rounding(law: LinearLaw, closed: Callable[[LinearLaw], tuple[Plant, Feedback]], plant: Plant) -> dict[str, Certificate]:
    """Returns the certificates of a law whose coefficients are rounded to each of `FORMATS`.

    Args:
        closed: function that returns, for a law, the plant with the states of the law, and the gain that represents the law.
        plant: plant without the law's states.
    """
    return {to: certify_tightly(*closed(round_law(law, to)), plant_without_law=plant) for to in FORMATS}


def round_law(law: LinearLaw, to: str) -> LinearLaw:
    """Returns a law with its matrices rounded to another number format.

    Args:
        to: number format "int16" or "float16". For "int16", the entries of each matrix are stored relative to the largest entry
            of the matrix. For "float16", a matrix with too large an entry is first divided by a power of two.
    """
    number = {"int16": _int16, "float16": _float16}[to]
    return LinearLaw(number(law.A), number(law.B), number(law.C), number(law.D), law.sample_period)


def _int16(matrix: Array) -> Array:
    largest = np.abs(matrix).max(initial=0.0)
    return np.round(matrix / largest * INT16) * (largest / INT16) if largest else matrix


def _float16(matrix: Array) -> Array:
    largest = np.abs(matrix).max(initial=0.0)
    scale = 2.0 ** max(0, np.ceil(np.log2(largest / FLOAT16))) if largest else 1.0
    return (matrix / scale).astype(np.float16).astype(float) * scale


# allowed relative increases of the norm due to gain errors; the tolerated errors are computed for each of them
SHARES = (0.01, 0.1)
# sizes of gain errors that are tried along a ray. The largest size, 1, means that a measurement or a force may be missing
AMOUNTS = tuple(0.75**k for k in reversed(range(20)))
# Largest number of factors for which every corner of the box gives a ray. With more factors, the rays are found by a vertex
# search in boxes of the sizes `SIZES`
EACH = 3
SIZES = (0.05, 0.25, 1.0)
EXACT = 1e-10  # relative accuracy to which the size of a gain error along a ray is computed
WITHIN = 1e-3  # relative amount by which a box is made smaller before it is searched for gain errors with the same effect
TURNS = 4  # the search for smaller gain errors is repeated at most this many times
# A proof of stability is tried for boxes that are smaller, by these relative amounts, than the smallest gain errors that were
# found to make the loop unstable
CLOSE = (1e-3, 1e-2, 0.05, 0.15, 0.3, 0.5, 0.75, 0.9)
# the corresponding relative amounts for boxes in which a bound on the norm is to be proved
CLOSE_TO_LEVEL = (1e-2, 0.05, 0.15, 0.3, 0.5, 0.75, 0.9)
LOOSELY = 4.0  # a proof of stability uses a bound on the norm that is this multiple of the largest norm found in the box


@dataclass(frozen=True, eq=False)
class ErrorMargin:
    """Margin of relative gain errors: a size of errors that is proved harmless, and a size that is harmful.

    Attributes:
        proved_margin: size up to which errors, in any combination, are proved harmless; 0 if nothing is proved.
        bound: proved bound on the norm for all errors up to `proved_margin`; infinite if nothing is proved.
        smallest_violation: size of the smallest harmful errors that were found; infinite if no errors up to 1 are harmful.
        readings, forces: smallest harmful relative errors of measurements and forces, shapes (q,) and (m,). If no errors are
            harmful, the attributes contain the errors of size 1 along the worst ray.
        proof: type of the proof; empty if nothing is proved.
    """

    proved_margin: float
    bound: float
    smallest_violation: float
    readings: Array
    forces: Array
    proof: str = ""


@dataclass(frozen=True, eq=False)
class Fragility:
    """Fragility of a loop: relative errors of measurements and forces that the loop tolerates.

    Attributes:
        norm: H-infinity norm of the loop without errors.
        stable: margin of errors up to which the loop remains stable.
        heights: function that gives the norm for factors on measurements and forces.
        rays: directions along which errors are tried, from the centre of a box to k corners, shape (k, q + m).
        shares: allowed relative increases of the norm, which are the keys of `within`.
    """

    norm: float
    stable: ErrorMargin
    heights: WorstCaseNormFunction
    rays: Array
    shares: tuple[float, ...] = SHARES

    @cached_property
    def within(self) -> dict[float, ErrorMargin]:
        """Margin of errors for each allowed relative increase of the norm; this increase is the key."""
        with numerics():
            return {share: _error_margin(self.heights, self.rays, self.norm * (1 + share)) for share in self.shares}


@numerics()
def fragility(gain: ScaledGain, norms: bool = True) -> Fragility:
    """Computes which relative errors of measurements and forces a loop tolerates. The loop must be stable without errors.

    Args:
        gain: loop with factors for its measurements and forces.
        norms: False to examine only stability, if the norm of `gain` is not the norm of the loop.

    Raises:
        ValueError: the loop is unstable without errors.
    """
    heights = WorstCaseNormFunction(gain)
    norm = heights.norm(_at(gain, 0.0))
    if not np.isfinite(norm):
        raise ValueError("the nominal loop is unstable")
    rays = _rays(heights)
    borne = _error_margin(heights, rays, np.inf)
    return Fragility(norm, borne, heights, rays) if norms else Fragility(np.inf, borne, heights, rays, ())


def box_of_all(gain: ScaledGain, amount: float) -> Box:
    """Returns the box of relative errors up to `amount` of all measurements and, if there are several forces, of all forces."""
    return box_of(gain, amount, amount if gain.forces > 1 else 0.0)


def _at(gain: ScaledGain, errors: Array | float) -> Array:
    return np.ones(sum(gain.K.shape)) + errors


def _rays(heights: WorstCaseNormFunction) -> Array:
    """Returns the k directions along which errors are tried, with entries 1, -1 and 0, shape (k, q + m)."""
    whole = box_of_all(heights.gain, 1.0)
    if len(whole.uncertain) <= EACH:
        corners = whole.vertices
    else:
        corners = np.concatenate([vertex_search(heights, box_of_all(heights.gain, size)) for size in SIZES])
    return np.unique(np.sign(corners - 1), axis=0)


def _error_margin(heights: WorstCaseNormFunction, rays: Array, level: float) -> ErrorMargin:
    """Returns the margin of errors for which the norm stays below a level; for an infinite level, the margin for which the loop
    stays stable.
    """
    gain = heights.gain
    amount, errors = _along_rays(heights, rays, level)
    for _ in range(TURNS):
        inside = WorstCaseNormFunction(gain)
        local_maximum(inside, box_of_all(gain, min(amount, 1.0) * (1 - WITHIN)))
        if not inside.highest > level * (1 + EXACT) and not np.isinf(inside.highest):
            break
        far = float(np.abs(inside.at - 1).max())
        ray = (inside.at - 1) / far
        amount = _edge(heights, ray, 0.0, far, level)
        errors = amount * ray
    errors_at = errors_of(gain, _at(gain, errors))
    tried = CLOSE if np.isinf(level) else CLOSE_TO_LEVEL
    sizes = [min(amount, 1.0) * (1 - smaller) for smaller in (tried if np.isfinite(amount) else (0.0, *tried))]
    proved, bound, kind, middle = 0.0, np.inf, "", 0  # the largest box is tried first, because its proof usually succeeds
    while sizes:  # a proof for one box is also valid for smaller boxes inside it
        box, within = box_of_all(gain, sizes[middle]), WorstCaseNormFunction(gain)
        if np.isinf(level):
            local_maximum(within, box)
        least = LOOSELY * within.highest if np.isinf(level) else level
        if np.isfinite(least) and (proof := prove_bound(within, box, least)) is not None:
            proved, bound, kind, sizes = sizes[middle], least, proof.kind, sizes[:middle]
        else:
            sizes = sizes[middle + 1 :]
        middle = len(sizes) // 2
    return ErrorMargin(proved, bound, amount, *errors_at, kind)


def _along_rays(heights: WorstCaseNormFunction, rays: Array, level: float) -> tuple[float, Array]:
    """Returns the smallest size of errors along the rays for which the norm exceeds a level, and the errors with this size.

    If the norm never exceeds the level, the size is infinite. For an infinite size, the errors are those at the end of the ray
    with the largest norm.
    """
    best, at = np.inf, None
    for ray in rays:
        low = 0.0
        for high in AMOUNTS:
            if low >= best:
                break
            point = _at(heights.gain, high * ray)
            if heights.exceeds(point, level) if np.isinf(level) else not heights.norm(point) <= level:
                edge = _edge(heights, ray, low, high, level)
                if edge < best:
                    best, at = edge, edge * ray
                break
            low = high
    if at is None:
        at = max(rays, key=lambda ray: heights.norm(_at(heights.gain, ray)))
    return float(best), at


def _edge(heights: WorstCaseNormFunction, ray: Array, low: float, high: float, level: float) -> float:
    """Returns the size of errors along a ray at which the norm reaches a level, by bisection between two sizes."""
    while high - low > EXACT * high:
        middle = (low + high) / 2
        over = heights.exceeds(_at(heights.gain, middle * ray), level)
        low, high = (low, middle) if over else (middle, high)
    return high


NOTHING = 1e-12  # a gain error smaller than this counts as zero
# two norms count as equal if they differ by less than this relative amount, as the two methods for a norm differ by as much
SAME = 1e-9


def record(
    report: Fragility, rounding: Mapping[str, Certificate], measured: Sequence[str], forces: Sequence[str]
) -> dict[str, Any]:
    """Returns the fragility as a JSON object with relative errors. Infinite values become None.

    Args:
        rounding: certificates of the rounded law, by number format.
        measured: names of the q measured signals.
        forces: names of the m forces.
    """
    margin = Record[ErrorMargin](
        proved="proved_margin",
        proof=lambda one: one.proof or None,
        bound="bound",
        found="smallest_violation",
        readings=lambda one: dict(zip(measured, one.readings.tolist(), strict=True)),
        forces=lambda one: dict(zip(forces, one.forces.tolist(), strict=True)),
    )
    rounded = Record[Certificate](norm=lambda one: one.norm.value, bound=lambda one: one.bound)
    return Record[Fragility](
        "norm",
        stable=margin.all("stable"),
        within=lambda of: [{"share": share, **margin(one)} for share, one in of.within.items()],
        rounding=rounded.all(lambda of: rounding),
    )(report)


def whose(report: Fragility) -> str:
    """Returns the names of the quantities that have errors, as text."""
    return "measurements and forces" if len(report.stable.forces) > 1 else "measurements"


def _percents(share: float, form: str = ".4g") -> str:
    return f"{100 * share:{form}} %"


def errors_text(one: ErrorMargin, measured: Sequence[str], forces: Sequence[str]) -> str:
    """Describes the harmful error of each signal; if no errors are harmful, describes the errors along the worst ray."""
    named = zip((*measured, *forces), (*one.readings, *one.forces), strict=True)
    return ", ".join(f"{name} {_percents(error, '+.4g')}" for name, error in named if abs(error) > NOTHING) or "none"


def fragility_text(report: Fragility, measured: Sequence[str], forces: Sequence[str]) -> str:
    """Describes the fragility of a law in one sentence."""
    found, errors, proved = report.stable.smallest_violation, errors_text(report.stable, measured, forces), proved_text(report)
    if not math.isfinite(found):
        return f"fragility: the search found no errors of {whose(report)} up to 100 % that make the loop unstable; {proved}"
    return f"fragility: {_percents(found)} errors of {whose(report)} ({errors}) make the loop unstable; {proved}"


def proved_text(report: Fragility) -> str:
    """Returns the proved margins of gain errors as text."""
    text = f"stability is {_proved_text(report.stable, 'each error')}"
    for share, one in report.within.items():
        beyond = (
            f"; errors of {_percents(one.smallest_violation)} violate this bound" if math.isfinite(one.smallest_violation) else ""
        )
        text += f"; a rise of the norm by at most {_percents(share)} is {_proved_text(one, 'errors')}{beyond}"
    return text


def _proved_text(one: ErrorMargin, what: str) -> str:
    if not one.proved_margin:
        return "not proved for any error"
    return f"proved for {what} up to {_percents(one.proved_margin)} ({one.proof})"


def rounding_text(norm: float, rounding: Mapping[str, Certificate]) -> str:
    """Describes the effect of rounded coefficients on the norm in one sentence; empty if no coefficients are rounded."""
    said = []
    for name, one in rounding.items():
        bound = f", proved below {digits(one.bound)}" if one.bound is not None else ""
        share = one.norm.value / norm - 1
        change = f"{percent(abs(share))} {'higher' if share > 0 else 'lower'}" if abs(share) > SAME else "unchanged"
        said.append(f"{name} {digits(one.norm.value)} ({change}{bound})" if one.stable else f"{name} UNSTABLE")
    return f"norm after rounding the law's coefficients: {'; '.join(said)}" if said else ""
