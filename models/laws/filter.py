"""Filters in a vehicle file, used as frequency weights (such as those of ISO 2631-1) and as shapes of road spectra.

A filter is a stable and proper ratio of polynomials in s, or several such ratios in series. The state-space form of each ratio
is the controllable form, in which time has a unit that depends on the ratio's poles. The coefficients in the controllable form
are those in the vehicle file, except for the rounding error of one division.

A weight may have one pole at 0, an integrator: F(s) = r / s + F_0(s), where r is the residue at 0, and F_0 is stable and
proper.
"""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any, ClassVar

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.checks import is_finite
from models.common.errors import InputError, error_in, short_repr
from models.common.schema import HERE, SI, Choice, ListedValues, Section
from models.laws.iso2631 import F1, F2, F3, F4, F5, F6, HORIZONTAL, Q1, Q2, Q4, Q5, Q6
from models.laws.linear import LinearLaw

Biquad = tuple[tuple[float, ...], tuple[float, ...]]  # coefficients of numerator and denominator, in descending powers of s


def _limits() -> tuple[Biquad, Biquad]:
    low, high = 2 * np.pi * F1, 2 * np.pi * F2
    return ((1.0, 0.0, 0.0), (1.0, low / Q1, low**2)), ((high**2,), (1.0, high / Q2, high**2))


def _step(f3: float, f4: float) -> Biquad:
    w3, w4 = 2 * np.pi * f3, 2 * np.pi * f4
    return (w4**2 / w3, w4**2), (1.0, w4 / Q4, w4**2)


def _upward() -> Biquad:
    w5, w6 = 2 * np.pi * F5, 2 * np.pi * F6
    return (1.0, w5 / Q5, w5**2), (1.0, w6 / Q6, w6**2)


WEIGHTINGS: dict[str, tuple[Biquad, ...]] = {
    "iso2631_wk": (*_limits(), _step(F3, F4), _upward()),
    "iso2631_wd": (*_limits(), _step(HORIZONTAL, HORIZONTAL)),
}


POLYNOMIALS = ("numerator", "denominator")
MOST = 12  # largest degree of a polynomial; the roots of polynomials with higher degrees are sensitive to rounding errors
# Allowed range of the magnitude of a coefficient; a polynomial of degree 12 with the fastest allowed pole is still inside this
# range
SMALLEST, LARGEST = 1e-60, 1e60
# Allowed range of the magnitude of a pole [rad/s]; poles outside this range are irrelevant for roads and cars
SLOWEST, FASTEST = 1e-6, 1e7
LEAST, MOST_GAIN = 1e-12, 1e12  # allowed range of the peak gain of a filter; outside this range, rounding errors dominate


@dataclass(frozen=True)
class Filter:
    """Stable and proper filter of one signal.

    Attributes:
        sections: numerator and denominator of each section; the sections are in series, and coefficients are in descending
            powers of s.
        name: name of a built-in filter; empty for a filter that the file gives by its coefficients.
        integrates: True if the filter may have a pole at 0; such a filter has only one section.

    Raises:
        InputError: a polynomial is invalid or zero, or its degree is too high. InputError is also raised if the filter is
            improper or unstable, or if a pole or the gain is out of range.
    """

    sections: tuple[Biquad, ...]
    name: str = ""
    integrates: bool = False

    def __post_init__(self) -> None:
        sections = tuple((_polynomial("numerator", above), _polynomial("denominator", below)) for above, below in self.sections)
        object.__setattr__(self, "sections", sections)
        for above, below in sections:
            _check(above, below, self.integrates)

    def response(self, omega: Array) -> Array:
        """Returns the frequency response of the filter, complex, with the same shape as omega [rad/s].

        At frequency 0, the response of an integrator is set to 0, because the mean of an integral is arbitrary.
        """
        omega = np.asarray(omega, dtype=float)
        free = (omega == 0) & bool(self.residue)
        s = 1j * np.where(free, 1.0, omega)
        found = np.prod([np.polyval(above, s) / np.polyval(below, s) for above, below in self.sections], axis=0)
        return np.where(free, 0.0, found)

    @functools.cached_property
    def residue(self) -> float:
        """Factor r of the integrator r / s in the filter; 0 if the filter has no pole at 0."""
        (above, below), *_ = self.sections
        return above[-1] / below[-2] if self.integrates and not below[-1] else 0.0

    @functools.cached_property
    def remainder(self) -> LinearLaw:
        """State-space form of F_0, the filter without its integrator."""
        return self._states(self._remaining)

    @property
    def without_integral(self) -> "Filter | None":
        """The filter F_0 without the integrator; None if F_0 is zero."""
        (above, _), *_ = sections = self._remaining
        return Filter(sections, self.name) if any(above) else None

    @functools.cached_property
    def realisation(self) -> LinearLaw:
        """State-space form of all sections in series; the units of the states are powers of two.

        The state of an integrator is the last state of the filter.
        """
        if not self.residue:
            return self._states(self.sections)
        rest = self.remainder
        A = np.pad(rest.A, (0, 1))
        return LinearLaw(A, np.vstack([rest.B, [[1.0]]]), np.hstack([rest.C, [[self.residue]]]), rest.D)

    @property
    def _remaining(self) -> tuple[Biquad, ...]:
        """The sections of F_0. For a filter N / (s D), F_0 is (N - r D) / (s D), whose numerator is divisible by s."""
        if not self.residue:
            return self.sections
        (above, below), *_ = self.sections
        rest = below[:-1]
        wide = np.concatenate([np.zeros(len(rest) + 1 - len(above)), above])
        left = wide - self.residue * np.concatenate([[0.0], rest])
        return ((tuple(left[:-1].tolist()), rest),)

    def _states(self, sections: tuple[Biquad, ...]) -> LinearLaw:
        A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
        for above, below in sections:
            one = _controllable(above, below)
            A = np.block([[A, np.zeros((len(A), one.states))], [one.B @ C, one.A]])
            B, C, D = np.vstack([B, one.B @ D]), np.hstack([one.D @ C, one.C]), one.D @ D
        return LinearLaw(A, B, C, D)

    @property
    def words(self) -> str:
        """The filter as text."""
        return self.name or " ".join(f"({_text(above)}) / ({_text(below)})" for above, below in self.sections)


POLYNOMIAL = ListedValues(
    "coefficients of a filter in descending powers of s", SI("", "", -LARGEST, LARGEST), ", in descending powers of s"
)


@dataclass(frozen=True)
class FilterSection(Section):
    """Section of a vehicle file that defines a filter: the name of a built-in filter, or the coefficients of a filter."""

    integrates: ClassVar[bool] = False  # True if the filter may have a pole at 0

    filter: (
        Annotated[str, Choice("name of a weighting of ISO 2631-1", (*WEIGHTINGS,), ", or a numerator and a denominator")] | None
    ) = None
    numerator: Annotated[tuple[float, ...], POLYNOMIAL] | None = None
    denominator: Annotated[tuple[float, ...], POLYNOMIAL] | None = None

    def __post_init__(self) -> None:
        if self.filter is not None and (self.numerator, self.denominator) != (None, None):
            raise InputError(f"has both filter and {POLYNOMIALS[self.numerator is None]}; give only one of them")
        with error_in(f"{HERE}:"):
            _ = self.shape

    @functools.cached_property
    def shape(self) -> Filter:
        """Filter that the section describes."""
        if self.filter is not None:
            return Filter(WEIGHTINGS[self.filter], self.filter)
        if self.numerator is None or self.denominator is None:
            raise InputError(
                "this is not a filter; give numerator = [...] and denominator = [...] with the coefficients in "
                f"descending powers of s, or give filter =  {' or '.join(map(repr, WEIGHTINGS))}"
            )
        return Filter(((self.numerator, self.denominator),), integrates=self.integrates)


def _polynomial(what: str, given: Sequence[Any]) -> tuple[float, ...]:
    """Returns the coefficients of a polynomial without leading zeros."""
    for one in given:
        if not is_finite(one) or not (one == 0 or SMALLEST <= abs(one) <= LARGEST):
            raise InputError(
                f"{what} has the coefficient {short_repr(one)}, which is not allowed; give 0 or a magnitude from "
                f"{SMALLEST:g} to {LARGEST:g}"
            )
    coefficients = tuple(float(one) for one in itertools.dropwhile(lambda one: one == 0, given))
    if not coefficients:
        raise InputError(
            f"all coefficients of the {what} are 0, but at least one must differ from 0; give the coefficients in "
            "descending powers of s"
        )
    if len(coefficients) > MOST + 1:
        raise InputError(
            f"{what} has degree {len(coefficients) - 1}, but at most {MOST} is allowed; give a filter of lower degree"
        )
    return coefficients


def _check(above: Sequence[float], below: Sequence[float], integrates: bool) -> None:
    """Raises InputError if a section of a filter is improper or unstable, or if a pole or the gain is out of range.

    Args:
        above: numerator coefficients.
        below: denominator coefficients.
        integrates: True if one pole may be 0.
    """
    if len(above) > len(below):
        raise InputError(
            f"the numerator has degree {len(above) - 1}, but the denominator only has degree {len(below) - 1}, so the "
            "gain grows without limit at high frequencies; give a denominator of at least the same degree"
        )
    if integrates and not below[-1] and len(below) > 1:
        if not above[-1]:
            raise InputError("the filter has a pole at 0 that a zero at 0 cancels; divide both numerator and denominator by s")
        below = below[:-1]
        if not below[-1]:
            raise InputError("the denominator has two roots at 0, which integrate twice; give at most one root at 0")
    if not _decays(below):
        advice = "; a weight may have one pole at 0, an integral" if integrates else ""
        raise InputError(f"the filter is unstable: a root of its denominator is not left of the imaginary axis{advice}")
    poles = np.abs(np.roots(below))
    beyond = [pole for pole in poles if not SLOWEST <= pole <= FASTEST]
    if beyond:
        raise InputError(
            f"the filter has a pole at {beyond[0]:.4g} rad/s, outside the allowed range; give poles from {SLOWEST:g} to "
            f"{FASTEST:g} rad/s"
        )
    around = np.geomspace(poles.min(initial=1.0) / 10, poles.max(initial=1.0) * 10, 200)
    largest = np.abs(np.polyval(above, 1j * around) / np.polyval(below, 1j * around)).max()
    if not LEAST <= largest <= MOST_GAIN:
        raise InputError(
            f"the largest gain of the filter is {largest:.3g}, outside the allowed range; give a largest gain from "
            f"{LEAST:g} to {MOST_GAIN:g}"
        )


def _decays(polynomial: Sequence[float]) -> bool:
    """Returns True if all roots of a polynomial are left of the imaginary axis, by the Routh array in exact rational
    arithmetic.
    """
    sign = 1 if polynomial[0] > 0 else -1
    exact = [sign * Fraction(one) for one in polynomial]
    above, below = exact[0::2], exact[1::2]
    for _ in range(len(exact) - 1):
        if not below or below[0] <= 0:
            return False
        ratio = above[0] / below[0]
        shifted = [one - ratio * two for one, two in itertools.zip_longest(above[1:], below[1:], fillvalue=Fraction(0))]
        above, below = below, shifted
    return True


def _controllable(above: Sequence[float], below: Sequence[float]) -> LinearLaw:
    """Returns the controllable form of a filter section, with balanced states and a unit of time that depends on the poles."""
    k = len(below) - 1
    a = np.array(below) / below[0]
    b = np.concatenate([np.zeros(k + 1 - len(above)), above]) / below[0]
    if not k:
        return LinearLaw(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), b[:, None])
    rate = np.exp2(np.round(np.log2(a[-1]) / k))
    powers = rate ** -np.arange(k + 1.0)
    a, b = a * powers, b * powers
    A = rate * np.vstack([-a[1:], np.eye(k)[:-1]])
    B, C = rate * np.eye(k)[:, :1], (b[1:] - b[0] * a[1:])[None]
    whole = np.block([[A, B], [C, np.zeros((1, 1))]])
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    unit = scale[:k] / scale[k]
    return LinearLaw(A / unit[:, None] * unit, B / unit[:, None], C * unit, b[:1, None])


def _text(polynomial: Sequence[float]) -> str:
    """Returns a polynomial in s as text."""
    terms = []
    for power, one in zip(range(len(polynomial) - 1, -1, -1), polynomial, strict=True):
        s = "" if not power else "s" if power == 1 else f"s^{power}"
        terms.append(f"{one:g}" if not s else s if one == 1 else f"{one:g} {s}")
    return " + ".join(term for term, one in zip(terms, polynomial, strict=True) if one).replace("+ -", "- ")
