"""Force elements whose voltage a controller sets, such as magnetorheological dampers. The elements take the place of force
actuators.

An element pulls with F(d, v, z, u), where u is the voltage relative to the voltage without a command. The controller requests a
force u* in addition to the force of the element without a command, as for other semi-active dampers
(`models.characteristics.adjustable_range`). At each sample, the element receives a voltage between 0 and its largest voltage.
With the voltage that the element receives, the change of the force

    -(F(d, v, z, u) - F(d, v, z, 0))

is as close as possible to the requested force u*, for the motion and the states at the sample. The voltage is held constant
until the next sample of the controller. If several voltages give the same force, the element receives the voltage that is
closest to the voltage without a command.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.characteristics.adjustable_range import CURVE_KEYS, Damper, check_unlimited
from models.common.arrays import Array
from models.common.checks import forwarded_attribute
from models.common.errors import InputError
from models.kinds.kind import Suspension
from models.parts.native import Tendon
from models.parts.part import Number, Part, SettablePart, Straight

SAME = 1e-12  # forces that differ by less than this share count as equal, because of rounding errors
SPEED = 1.0  # the element is represented by its damping coefficient at this velocity [m/s]


@dataclass(frozen=True)
class ElementDamper(Damper):
    """Element of `[parts]` that acts as a semi-active damper.

    The limits of the semi-active damper are the damping coefficients at 1 m/s, for 0 V and for the largest voltage.

    Attributes:
        name: name of the element's section.
        element: element of `[parts]` that acts as the damper.
    """

    replaces = False

    name: str = ""
    element: Any = None

    @classmethod
    def of(cls, one: Any) -> "ElementDamper":
        """Returns the semi-active damper that represents an element."""
        part: Any = one.part
        low, high = (float(part.after_yield(np.array(SPEED), u)) / SPEED for u in part.settable)
        return cls(low, high, part.bandwidth, None, one.name, part)

    def among(self, elements: Sequence[Any]) -> "ElementDamper":
        return ElementDamper.of(next(one for one in elements if one.name == self.name))

    @property
    def words(self) -> str:
        lag = "" if self.bandwidth is None else f", with a lag of {self.bandwidth:g} rad/s"
        return f"a semi-active {self.name} of 0 to {self.element.largest_voltage:g} V{lag}"

    @staticmethod
    def together(dampers: Sequence["ElementDamper"], shape: tuple[int, ...]) -> "ElementDamper":
        """Combines several dampers that differ only in their numbers into one damper."""
        return dampers[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class SetElement(SettablePart):
    """Force element whose input is its voltage, before the motion ratio is applied.

    Attributes:
        element: element whose voltage a controller sets.
        without: the same element without a command, or the linearisation of this element.
    """

    element: Any
    without: Part

    states, fastest = forwarded_attribute("element.states"), forwarded_attribute("element.fastest")
    stored, limits = forwarded_attribute("without.stored"), forwarded_attribute("without.limits")
    line, is_nonlinear, range, kinked_at_rest = (  # pyright: ignore[reportIncompatibleMethodOverride]
        forwarded_attribute(f"without.{name}") for name in ("line", "is_nonlinear", "range", "kinked_at_rest")
    )
    words = forwarded_attribute("damper.words")  # pyright: ignore[reportIncompatibleMethodOverride]

    @property
    def coefficient(self) -> str:
        """Name of the signal with the element's actual voltage."""
        return f"voltage{self.ending}"

    @property
    def low(self) -> Number:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Smallest voltage of the element relative to the voltage without a command [V]."""
        return self.element.settable[0]

    @property
    def high(self) -> Number:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Largest voltage of the element relative to the voltage without a command [V]."""
        return self.element.settable[1]

    @property
    def slopes(self) -> tuple[float, float]:
        least, now, most = (float(self.element.pull(0.0, 1.0, np.zeros(len(self.states)), u)) for u in (self.low, 0.0, self.high))
        return least - now, most - now

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        if not isinstance(self.without, Straight):
            return self.element.pull(d, v, z, u)
        return self.without.pull(d, v, z) - self.push(d, v, z, u)

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.without.rate(d, v, z) if isinstance(self.without, Straight) else self.element.rate(d, v, z, u)

    def push(self, d: Array, v: Array, z: Any, u: Array | float, before: Array | float = 0.0) -> Array:
        """Returns the change of the pushing force when the voltages change from `before` to u [N], shape (...).

        Args:
            d: extension of the suspension [m], shape (...).
            v: rate of the suspension's extension [m/s], shape (...).
            z: internal states, shape (..., n).
            u: voltages [V], relative to the voltage without a command.
            before: voltages whose pushing force is subtracted [V], relative to the voltage without a command.
        """
        return self.element.pull(d, v, z, before) - self.element.pull(d, v, z, u)

    def force_at(self, v: Array, beyond: Array | float) -> Array:
        """See `SettablePart.force_at`. The forces are those after yield, without the forces of springs."""
        return self.element.after_yield(v, beyond)

    def setting(self, force: Array, d: Array, v: Array, z: Any) -> Array:
        """Returns the voltages at which the force of the element is closest to the requested forces [V], shape (...).

        The voltages are relative to the voltage without a command. The product of `pull` and `Part.divisor` is a quadratic
        function of the voltage. Therefore, the voltages at which the pull equals the requested pull are roots of a quadratic
        equation. The extremes of the pull are at the ends of the voltage range and at the roots of a second quadratic equation.
        """
        low, high, pull = self.low, self.high, self.element.pull
        wanted, wide = pull(d, v, z, 0.0) - force, high - low
        a, b = self.element.divisor(low), self.element.divisor(high)
        first, middle, last = (pull(d, v, z, u) * self.element.divisor(u) for u in (low, low + wide / 2, high))
        bent, slope = 2 * (first - 2 * middle + last), 4 * middle - 3 * first - last
        some = [np.zeros_like(wanted), np.ones_like(wanted), np.zeros_like(wanted) - low / wide]
        with np.errstate(all="ignore"):
            some += _roots(bent, slope - wanted * (b - a), first - wanted * a)
            some += _roots(bent * (b - a), 2 * bent * a, slope * a - first * (b - a))
            settings = low + wide * np.clip(np.nan_to_num(np.stack(some)), 0.0, 1.0)
            pulls = pull(d, v, z, settings)
            away = np.nan_to_num(np.abs(pulls - wanted), nan=np.inf)
            near = away <= away.min(axis=0) + SAME * (np.abs(pulls).max(axis=0) + np.abs(wanted))
        best = np.where(near, np.abs(settings), np.inf).argmin(axis=0)
        return np.take_along_axis(settings, best[None], axis=0)[0]

    def write_input(self, tendon: Tendon, by_motor: bool) -> None:
        tendon.adjust_input(self.force, 0.0, (), float(self.low), self.ratio, self.damper.bandwidth)


def _roots(a: Array, b: Array, c: Array) -> list[Array]:
    """Returns the roots of a x^2 + b x + c, even if a is 0; NaN if the roots are complex."""
    q = -(b + np.where(b < 0, -1.0, 1.0) * np.sqrt(b * b - 4 * a * c)) / 2
    return [q / a, c / q]


def set_element(damper: ElementDamper, place: Suspension, part: Part) -> SetElement:
    """Returns the force element at a suspension; a controller sets the voltage of the element. The argument `part` is the
    element or its linearisation.
    """
    return SetElement(place.force, place.ending, damper, damper.element.voltage, element=damper.element, without=part)


def element_dampers(
    elements: Sequence[Any], suspensions: Sequence[Suspension], actuators: Mapping[str, Any], limited: Sequence[str]
) -> dict[str, ElementDamper]:
    """Returns the semi-active dampers that represent the elements whose voltage a controller sets.

    The key of each damper is the name of the control force that its element replaces.

    Args:
        elements: all elements of the vehicle.
        suspensions: suspensions of the vehicle.
        actuators: section `[actuators]` of the vehicle file.
        limited: keys of `[limits]` that limit force actuators.

    Raises:
        InputError: the suspension has no actuator or a different one, or `[limits]` limits force actuators.
    """
    dampers = dict[str, ElementDamper]()
    for one in elements:
        for place in suspensions if one.part.settable is not None else ():
            if place.corner not in one.corners:
                continue
            what, where = f"[parts.{one.name}] largest_voltage", f" at {place.corner}" if place.corner else ""
            if not place.force:
                raise InputError(f"{what} needs an actuator{where}, which this vehicle type does not have; omit largest_voltage")
            if place.force in dampers:
                other = dampers[place.force].name
                raise InputError(
                    f"{what} and [parts.{other}] largest_voltage both control {place.force}, but only one element can; "
                    "omit largest_voltage in one of the two elements"
                )
            own = place.ending.removeprefix("_")
            if own in actuators or any(not isinstance(value, Mapping) or key in CURVE_KEYS for key, value in actuators.items()):
                raise InputError(
                    f"{what} and [actuators] both control {place.force}, but only one actuator can; omit one of the two "
                    "at this suspension"
                )
            dampers[place.force] = ElementDamper.of(one)
    if dampers:
        check_unlimited(limited, f"[parts.{next(iter(dampers.values())).name}] has a semi-active damper")
    return dampers
