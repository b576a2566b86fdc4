"""Nonlinear elements of a vehicle: curved dampers and springs, and adjustable dampers. The vehicle that is linear at rest.

For a force f over the velocity or deflection y of a suspension, with x the states,

    f = p(y),    y = Y x,

where p is the part of a curve beyond its line (`models.parts`), as its line belongs to the linear model. A damper's p may be
over velocity and deflection.

At rest: ideal force actuators replace adjustable dampers. A curve that is straight about rest stays: a small enough road meets
its line alone. A line replaces a curve that bends at rest, by a kink or by friction: no road is small enough for that one.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.linear_model import LinearModel
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.characteristics.curve import ForceCurve


def bent_at_rest(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the parameters whose curves are not straight about rest, in the order of the suspensions."""
    return tuple(dict.fromkeys(fitted.parameter for fitted in vehicle.fitted if fitted.part.kinked_at_rest))


def at_rest(vehicle: Vehicle) -> Vehicle:
    """Returns the vehicle that is linear on small enough roads."""
    return vehicle.with_ideal_actuators.linearised if bent_at_rest(vehicle) else vehicle.with_ideal_actuators


def at_rest_words(vehicle: Vehicle) -> str:
    """Describes the elements that MuJoCo runs otherwise in that vehicle; empty if there are none."""
    bent, phrases = bent_at_rest(vehicle), []
    if vehicle.dampers:
        phrases.append("force actuators instead of the adjustable dampers, so that every requested force acts")
    if bent:
        whose = " and ".join(name.replace("_", " ") for name in bent)
        phrases.append(f"straight lines instead of the curves of {whose}, which have a kink at equilibrium")
    return f"Here, MuJoCo has {' and '.join(phrases)}" if phrases else ""


@dataclass(frozen=True, eq=False)
class Elements:
    """Curves, e of them, on a linear model of n states and p outputs.

    Attributes:
        curves: the curve of each element.
        rows, of_road: gains from states and road heights to the argument y of each force, shapes (e, n) and (e, r).
        push: gain from the pulling forces to the rates of the states, shape (n, e).
        outputs: gain from the forces to the outputs, shape (p, e).
        travels, travels_of_road: gains from states and road heights to the deflection of each `ForceSurface`, shapes (s, n) and
            (s, r).
    """

    curves: "tuple[ForceCurve, ...]"
    rows: Array
    of_road: Array
    push: Array
    outputs: Array
    travels: Array
    travels_of_road: Array


def elements(vehicle: Vehicle, model: LinearModel) -> Elements:
    """Returns the curves of a vehicle on its linear model, or on a larger one with the same outputs and its states first."""
    curved = [fitted for fitted in vehicle.fitted if fitted.curve.bent]
    index = [model.outputs.index(fitted.argument) for fitted in curved]
    push, outputs = vehicle.pulls_on([fitted.deflection for fitted in curved])
    push = np.vstack([push, np.zeros((len(model.A) - len(push), len(curved)))])
    rows = model.C[index]
    travel = [model.outputs.index(fitted.deflection) for fitted in curved if fitted.surface is not None]
    travels = model.C[travel], model.Cr[travel] + model.C[travel] @ model.jump
    of_road = model.Cr[index] + rows @ model.jump
    return Elements(tuple(fitted.curve for fitted in curved), rows, of_road, push, outputs, *travels)
