"""Semi-active dampers in a vehicle, and the characteristics in `[curves]` that act in parallel with these dampers.

If a suspension with a semi-active damper also has a characteristic in `[curves]`, the characteristic acts in parallel with the
damper, like the friction of a strut. At every setting of the damper, only the deviation of the parallel characteristic from its
linearisation acts, because the semi-active damper replaces the linear part.

If c_s is the nominal coefficient and c_s + d the set coefficient, the damper and the parallel characteristic together pull with
the force

    c_s v + g(v) + d h(v).

The function h is h(v) = v, except for a damper with two characteristics (`models.characteristics.adjustable_range`). The
deviation g is the sum of two deviations from linearisations: that of the nominal setting, and that of the parallel
characteristic.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.characteristics.adjustable_range import Damper
from models.characteristics.curve import ForceCurve
from models.characteristics.surface import ForceSurface
from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.kind import Suspension
from models.parts.characteristic import departures
from models.parts.native import Tendon
from models.parts.part import Limit, Line, Part, SettablePart

ROUNDING = 1e-9  # a force below this share of the largest force of the nominal characteristic counts as a rounding error


@dataclass(frozen=True)
class Adjustable(SettablePart):
    """Semi-active damper as a part of a suspension."""

    argument = "velocity"
    native = True

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.pull`. The input u of the damper is its coefficient minus the nominal coefficient [N s/m]."""
        return self.ratio * self.force_at(self.ratio * v, u)

    def beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        own = self.ratio * v
        set_force = u * self.shape(own)
        return self.ratio * (set_force if self.nominal_curve is None else self.nominal_curve.pieces.force(own) + set_force)

    @cached_property
    def line(self) -> Line:
        """See `Part.line`. The linearisation of the force is that of the damper at its nominal setting."""
        return Line(0.0, self.ratio**2 * self.nominal)

    @property
    def is_nonlinear(self) -> bool:
        """True if the damper's force at the nominal setting differs from its linearisation."""
        return self.nominal_curve is not None and self.nominal_curve.is_nonlinear

    @property
    def kinked_at_rest(self) -> bool:
        return self.nominal_curve is not None and bool((self.nominal_curve.pieces.start == 0).any())

    @cached_property
    def curve(self) -> ForceCurve | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `Part.curve`. The characteristic of the damper at its nominal setting; None if the characteristic is straight."""
        return self.nominal_curve and self.nominal_curve.at_wheel(self.ratio)

    def limits(self) -> Sequence[Limit]:
        """Returns the velocities beyond which the damper's nominal force deviates too much from its linearisation."""
        return () if self.curve is None else departures(self.curve, "velocity")

    def at_wheel(self, ratio: float) -> "Adjustable":
        return replace(self, ratio=self.ratio * ratio)

    def write(self, tendon: Tendon) -> None:
        """Writes the part of the force that does not depend on the damper's setting. See `Part.write`."""
        if self.offset is not None:
            tendon.add_pieces("velocity", self.offset.at_wheel(self.ratio).pieces, over_speed=True)

    def write_input(self, tendon: Tendon, by_motor: bool) -> None:
        line, ramps = (1.0, ()) if self.damper.pair is None else (self.damper.pair.line, self.damper.pair.ramps)
        shape = (0.0, ()) if by_motor else (line, ramps)
        tendon.adjust_input(self.force, *shape, self.low, self.ratio, self.damper.bandwidth)

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the semi-active damper of a suspension, before its motion ratio is applied.

        Raises:
            InputError: the vehicle type has no nominal damper at the suspension, the nominal coefficient is outside the limits,
                or the parallel characteristic supplies energy.
        """
        dampers, suspensions, name = vehicle.dampers, vehicle.kind.suspensions, place.damping
        if not vehicle.adjusted(place.force):
            return
        damper, beside = dampers[place.force], vehicle.curves.get(name)
        if not name:
            raise InputError(
                f"[actuators] the vehicle type defines no damper at {place.force}; in the vehicle type, give "
                f"`damping` in the Suspension whose force is {place.force}"
            )
        if isinstance(beside, ForceSurface):
            raise InputError(
                f"[curves] {name} depends on velocity and deflection, but [actuators] gives this suspension a semi-active "
                "damper; omit one of the two, or give a curve that depends only on velocity"
            )
        nominal = vehicle.parameters[name]
        if not damper.c_min <= nominal <= damper.c_max:
            raise InputError(
                f"{name} = {nominal:g} N s/m, which applies while the controller gives no command, is not between "
                f"c_min = {damper.c_min:g} and c_max = {damper.c_max:g} N s/m of [actuators]; change {name}, c_min or "
                "c_max"
            )
        one = cls(place.force, place.ending, damper, nominal, 1.0, _nominal_curve(damper, nominal, beside))
        _check_takes(name, one)
        pairs = [dampers[other.force].pair for other in suspensions if other.damping == name and vehicle.adjusted(other.force)]
        if damper.pair is not None and not all(damper.pair.same(pair) for pair in pairs):
            raise InputError(
                f"[actuators] suspensions with the same parameter {name} have different damper curves; give the same "
                "c_min and c_max to all of these suspensions"
            )
        yield one, name

    @staticmethod
    def check_measured(name: str, measured: Sequence[str], vehicle: Any) -> None:
        """Checks that a controller measures only forces for which MuJoCo has sensors.

        MuJoCo cannot measure the force of a semi-active damper that has characteristics, is an element of `[parts]`, or has a
        motion ratio that changes with travel.

        Args:
            name: name of the controller.
            measured: signals that the controller measures.
            vehicle: vehicle in which the controller acts.

        Raises:
            InputError: the controller measures a force for which MuJoCo has no sensor.
        """
        turning = {place.force for place in vehicle.kind.suspensions if vehicle.kind.table_of(place) is not None}
        for one in vehicle.parts.adjustable:
            if one.force in measured and (one.force in turning or one.damper.pair is not None or not one.damper.replaces):
                what, instead = "with curves c_min and c_max", ", or give numbers for c_min and c_max"
                if one.force in turning:
                    what, instead = "whose motion ratio changes with travel", ", or give a constant motion ratio"
                if not one.damper.replaces:
                    what, instead = "of [parts]", ""
                raise InputError(
                    f"[controllers.{name}] measures {one.force}, but no sensor measures the force of a damper {what}; "
                    f"measure suspension_velocity instead{instead}"
                )

    @property
    def offset(self) -> ForceCurve | None:
        """Characteristic of the part of the force that does not depend on the damper's setting; None if this part of the force
        is zero.

        The other actuators of the damper give the forces (c - c_s) l v and (c - c_min) (h(v) - l v), where l is the slope of h
        at equilibrium.
        """
        if self.nominal_curve is None or self.damper.pair is None:
            return self.nominal_curve
        pair, x = self.damper.pair, np.union1d(self.nominal_curve.x, self.damper.pair.knots)
        bent = self.nominal_curve.pieces.force(x) + self.low * (pair.shape(x) - pair.line * x)
        return replace(self.nominal_curve, x=x, force=self.nominal * x + bent)


def _nominal_curve(damper: Damper, nominal: float, beside: ForceCurve | None) -> ForceCurve | None:
    """Returns `Adjustable.nominal_curve`, to which a parallel characteristic adds only its deviation from its linearisation."""
    parts = [(1.0, beside.x, beside.pieces)] if beside is not None else []
    if damper.pair is not None:
        share, pair = (nominal - damper.c_min) / (damper.c_max - damper.c_min), damper.pair
        parts += [(1 - share, pair.soft.x, pair.soft.pieces), (share, pair.hard.x, pair.hard.pieces)]
    if not parts:
        return None
    x = np.unique(np.concatenate([points for _, points, _ in parts]))
    bent = sum((weight * pieces.force(x) for weight, _, pieces in parts), np.zeros_like(x))
    return ForceCurve(x, nominal * x + bent, nominal, "the nominal damper, with the curve parallel to it")


def _check_takes(parameter: str, one: Adjustable) -> None:
    """Checks that the softest setting with the parallel characteristic dissipates energy at every velocity.

    Firmer settings dissipate more energy than the softest setting.
    """
    if one.nominal_curve is None:
        return
    x = one.nominal_curve.x
    pull, far = one.force_at(x, one.low), 2 * x[[0, -1]]
    on = (one.force_at(far, one.low) - pull[[0, -1]]) / x[[0, -1]]
    feeding = np.flatnonzero(pull * np.sign(x) < -ROUNDING * one.nominal_curve.range)
    where = [f"at {x[i]:g} m/s" for i in feeding[:1]]
    where += [f"beyond {x[end]:g} m/s, where its end is extended" for end in (0, -1) if on[end] < -ROUNDING * one.steepest_slope]
    if where:
        raise InputError(
            f"[curves] {parameter} is parallel to a semi-active damper, and at c_min both together supply energy "
            f"{where[0]}. Give only linear damping and friction here; give the damper's measured limits as c_min and "
            "c_max"
        )
