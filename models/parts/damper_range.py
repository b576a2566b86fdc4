"""Setting range of semi-active dampers, and the part of a requested force that the dampers cannot give because of this range."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.characteristics.curve import Pieces
from models.common.arrays import Array
from models.parts.part import choose_runs, merge_parts

STILL = 1e-150  # this velocity [m/s] replaces a velocity of 0, to avoid division by 0


@dataclass(frozen=True, eq=False)
class CoefficientRange:
    """Limits of the coefficients relative to the nominal coefficients, for N runs with m actuators each.

    Force actuators are included with infinite limits. The closing velocity of a force actuator is defined as 1, so its
    coefficient equals its force.

    Attributes:
        low: smallest coefficient minus the nominal coefficient [N s/m], shape (N, m).
        high: largest coefficient minus the nominal coefficient [N s/m], shape (N, m).
        nominal: nominal coefficient [N s/m], 0 for force actuators, shape (N, m).
        adjustable: True for semi-active dampers, equal in all runs, shape (m,).
        elements: force elements whose voltages a controller sets. For a force element, the limits, the nominal value and the
            coefficient are voltages [V].
        deviations: deviation of the function h in `models.characteristics.adjustable_range` from its linearisation, and
            deviation of the softest setting from its linearisation. Each deviation has P segments, shape (N, m, P). The
            deviations are None if all characteristics are straight.
    """

    low: Array
    high: Array
    nominal: Array
    adjustable: Array
    deviations: tuple[Pieces, Pieces] | None = None
    elements: tuple["SetColumn", ...] = ()

    @property
    def curved(self) -> bool:
        """True if the limits of the coefficients depend on the motion of the suspensions."""
        return self.deviations is not None or bool(self.elements)

    def closing(self, speeds: Array, travels: Array, z: Array) -> Array:
        """Returns the closing velocities, followed by the travel and the states of each element, shape (..., N, m + c).

        Args:
            speeds: extension rates of semi-active dampers [m/s], 0 for force actuators, shape (..., N, m).
            travels: deflections of all suspensions at the wheels [m], shape (..., N, s).
            z: internal states of all parts, shape (..., N, k).
        """
        return np.concatenate([self.at_rest - speeds, *self.of_elements(travels, z)], axis=-1)

    def of_elements(self, travels: Array, z: Array) -> list[Array]:
        """Returns the travel and the states of each element, shapes (..., N, c). For the arguments, see `closing`."""
        pairs = [
            (one.own_motion(travels[..., one.place], 0.0 * travels[..., one.place]), z[..., one.states]) for one in self.elements
        ]
        return [part for (travel, _), own in pairs for part in (travel[..., None], own)]

    def effective_velocity(self, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the factor that converts a coefficient to a force, shape (..., N, m).

        For a damper, the factor is the closing velocity [m/s], corrected for nonlinear characteristics. For a force element,
        the factor is its mean force per volt [N/V].
        """
        rates = list[tuple[SetColumn, Array]]()
        for one in self.elements:
            (part, motion), low, high = (
                one.at(closing, which),
                self.low[which][..., one.column],
                self.high[which][..., one.column],
            )
            rates.append((one, part.push(*motion, high, low) / (high - low)))
        return _with(self._velocity(closing, which), rates)

    def _velocity(self, closing: Array, which: Array | slice) -> Array:
        """Returns `effective_velocity` for dampers, and the closing velocity for force elements."""
        closing = closing[..., : self.low.shape[1]]
        return closing if self.deviations is None else closing - self.deviations[0][which].force(-closing)

    def secant_limits(self, c_min: Array, c_max: Array, closing: Array, which: Array | slice) -> tuple[Array, Array]:
        """Returns a damper's smallest and largest ratios of force to velocity at the supplied velocities, shapes (N, m).

        Args:
            c_min: smallest coefficient at velocity 0 [N s/m], shape (N, m).
            c_max: largest coefficient at velocity 0 [N s/m], shape (N, m).
            closing: closing velocity of each suspension [m/s], not 0, as `closing` returns it, shape (N, m + c).
            which: runs that are selected from the N runs.
        """
        speeds = closing[..., : self.low.shape[1]]
        if self.deviations is not None:
            least = c_min - self.deviations[1][which].force(-speeds) / speeds
            c_min, c_max = least, least + (c_max - c_min) * self._velocity(closing, which) / speeds
        if not self.elements:
            return c_min, c_max
        c_min, c_max = (np.array(np.broadcast_to(c, speeds.shape)) for c in (c_min, c_max))
        for one in self.elements:
            part, (d, v, z) = one.at(closing, which)
            for limit, u in ((c_min, part.low), (c_max, part.high)):
                limit[..., one.column] = part.element.pull(d, v, z, u) / v
        return c_min, c_max

    def forces(self, beyond: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the forces [N] at the supplied settings, which are relative to the nominal settings, shape (..., N, m)."""
        parts = [(one, *one.at(closing, which)) for one in self.elements]
        pushes = [(one, part.push(*motion, beyond[..., one.column])) for one, part, motion in parts]
        return _with(beyond * self._velocity(closing, which), pushes)

    def settings(self, forces: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the settings, relative to the nominal settings, at which the forces are closest to the requested forces [N].

        The shape is (..., N, m).
        """
        parts = [(one, *one.at(closing, which)) for one in self.elements]
        own = [(one, part.setting(forces[..., one.column], *motion)) for one, part, motion in parts]
        return _with(self._clip(forces / self._velocity(closing, which), which), own)

    def commands(self, requested_force: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the settings of the actuators, followed by the missing forces, shape (..., N, 2 m).

        The first m columns are coefficients minus nominal coefficients [N s/m], voltages relative to the voltages without a
        command [V], or forces of force actuators [N]. The last m columns are the requested forces minus the forces at the
        settings in the first m columns [N].

        Args:
            requested_force: requested forces [N], followed by the motion of each suspension, as `closing` returns it, shape
                (..., N, 2 m + c).
            which: runs that are selected from the N runs.
        """
        forces, closing = np.split(requested_force, [self.low.shape[1]], axis=-1)
        beyond = self.settings(forces, closing, which)
        return np.concatenate([beyond, forces - self.forces(beyond, closing, which)], axis=-1)

    def clip_coefficients(self, coefficients: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns an array of the same form as `commands`, but for requested coefficients instead of forces; shape (..., N, 2
        m).

        Args:
            coefficients: requested coefficients of the dampers, force divided by velocity [N s/m], shape (..., N, m).
            closing: closing velocity of each suspension [m/s], as `closing` returns it, shape (..., N, m + c).
            which: runs that are selected from the N runs.
        """
        speeds, turned = closing[..., : self.low.shape[1]], self._velocity(closing, which)
        whole, coefficients = coefficients * speeds, coefficients - self.nominal[which]
        if self.deviations is not None:  # the requested coefficients are converted to coefficients at velocity 0
            low, soft = self.low[which], self.deviations[1][which].force(-speeds)
            coefficients = low + (coefficients - low + soft / speeds) * (speeds / turned)
        beyond = self._clip(coefficients, which)
        found = np.concatenate([beyond, (coefficients - beyond) * turned], axis=-1)
        for one in self.elements:  # the force that is requested from each element is the force of the whole damper
            part, motion = one.at(closing, which)
            force = whole[..., one.column] + part.element.pull(*motion)
            found[..., one.column] = beyond = part.setting(force, *motion)
            found[..., self.low.shape[1] + one.column] = force - part.push(*motion, beyond)
        return found

    def _clip(self, coefficients: Array, which: Array | slice) -> Array:
        return np.minimum(np.maximum(coefficients, self.low[which]), self.high[which])

    def clipped_off(self, forces: Array, closing: Array | None, which: Array | slice = slice(None)) -> Array:
        """Returns the forces that the actuators can give minus the requested forces [N], shape (N, m); exactly 0 if no force is
        clipped.

        Args:
            forces: requested forces [N], shape (N, m).
            closing: motion of each suspension, as in `commands`, shape (N, m + c); None if all actuators are force actuators.
            which: runs that are selected from the N runs.
        """
        turned = 1.0 if closing is None else self._velocity(closing, which)
        coefficients = forces / turned
        lost = (self._clip(coefficients, which) - coefficients) * turned
        if self.elements and closing is not None:
            given = self.forces(self.settings(forces, closing, which), closing, which) - forces
            lost = _with(lost, [(one, given[..., one.column]) for one in self.elements])
        return lost

    @property
    def at_rest(self) -> Array:
        """Offsets that keep the closing velocities in `commands` from being 0, shape (m,)."""
        return np.where(self.adjustable, STILL, 1.0)


def _with(values: Array, columns: Sequence[tuple["SetColumn", Array]]) -> Array:
    """Returns the values of all actuators, shape (..., m), after replacing the columns of the force elements by values for the
    elements.
    """
    if not columns:
        return values
    values = np.array(values)
    for one, column in columns:
        values[..., one.column] = column
    return values


@dataclass(frozen=True, eq=False)
class SetColumn:
    """Force elements of N vehicles at one suspension; a controller sets the voltages of these elements.

    Attributes:
        column: index of the element's force among the inputs of the vehicle.
        place: index of the suspension on which the elements act.
        names: signals of the suspension's deflection and velocity at the wheel.
        states: columns of the element's states among the states of all parts.
        own: names of the elements' internal states.
        start: index of the column in `CoefficientRange.closing` that contains the element's travel; the columns of its internal
            states follow.
        parts: the elements after their motion ratios are applied: one element that all runs share, or N elements.
        element: the N elements combined into one part, before the motion ratio is applied.
    """

    column: int
    place: int
    names: tuple[str, str]
    states: slice
    own: tuple[str, ...]
    start: int
    parts: Sequence[Any]
    element: Any

    def own_motion(self, d: Array, v: Array) -> tuple[Array, Array]:
        """Returns travels [m] and velocities [m/s] of the elements, for travels and velocities at the wheel, shapes (..., N)."""
        if len(self.parts) == 1:
            return self.parts[0].own_motion(d, v)
        pairs = [part.own_motion(d[..., i], v[..., i]) for i, part in enumerate(self.parts)]
        return np.stack([d for d, _ in pairs], axis=-1), np.stack([v for _, v in pairs], axis=-1)

    def motion(self, signal: Callable[[str], Array]) -> tuple[Array, Array, Array]:
        """Returns travels, velocities and states of the elements from signals of shape (..., N)."""
        d, v = self.own_motion(*map(signal, self.names))
        return d, v, np.stack([signal(name) for name in self.own], axis=-1)

    def at(self, closing: Array, which: Array | slice) -> tuple[Any, tuple[Array, Array, Array]]:
        """Returns selected elements, and their travels, velocities and states from the array of `CoefficientRange.closing`."""
        own = closing[..., self.start + 1 : self.start + 1 + len(self.own)]
        return choose_runs(self.element, which), (closing[..., self.start], -closing[..., self.column], own)


def range_of(vehicles: Sequence[Any], most: Sequence[float | None] = ()) -> CoefficientRange:
    """Returns the setting range of the actuators of N vehicles of one type.

    Args:
        vehicles: N vehicles whose actuators are limited.
        most: largest force of the force actuators of each vehicle [N]; None for no limit.
    """
    forces = vehicles[0].linear_model.inputs
    largest = np.array([np.inf if force is None else force for force in most or [None] * len(vehicles)])
    high = np.repeat(largest[:, None], len(forces), axis=1)
    low, nominal, adjustable = -high, np.zeros(high.shape), np.zeros(high.shape, dtype=bool)
    pairs = [[None] * len(forces) for _ in vehicles]
    for i, vehicle in enumerate(vehicles):
        for damper in vehicle.parts.adjustable:
            j = forces.index(damper.force)
            low[i, j], high[i, j], nominal[i, j], adjustable[i, j] = damper.low, damper.high, damper.nominal, True
            pairs[i][j] = damper.damper.pair
    assert np.all(adjustable == adjustable[0]), "vehicles side by side have their dampers at the same places"
    curved = CoefficientRange(low, high, nominal, adjustable[0], None, _elements(vehicles))
    every = [pair for row in pairs for pair in row]
    if not any(every):
        return curved
    shape = [pair and pair.shape.pieces for pair in every]
    soft = [pair and pair.soft.pieces for pair in every]
    return replace(curved, deviations=(Pieces.stacked(shape, high.shape), Pieces.stacked(soft, high.shape)))


def _elements(vehicles: Sequence[Any]) -> tuple[SetColumn, ...]:
    """Returns the force elements of N vehicles whose voltages a controller sets."""
    first, start, columns = vehicles[0], len(vehicles[0].linear_model.inputs), list[SetColumn]()
    dampers, states = {one.force: one for one in first.parts.adjustable}, 0
    same = all(vehicle is first for vehicle in vehicles)
    for k, one in enumerate(first.parts):
        n, before = len(one.part.states), states
        states += n
        damper = dampers.get(one.place.force)
        if damper is None or getattr(damper.damper, "name", "") != one.element or not one.element:
            continue
        parts = [vehicle.parts[k].part for vehicle in (vehicles[:1] if same else vehicles)]
        own = [getattr(part, "part", part) for part in parts]
        columns.append(
            SetColumn(
                first.linear_model.inputs.index(damper.force),
                first.kind.suspensions.index(one.place),
                (one.deflection, one.place.velocity.name),
                slice(before, states),
                tuple(signal.name for signal in one.states),
                start,
                parts,
                merge_parts(own, (len(own),)),
            )
        )
        start += 1 + n
    return tuple(columns)
