"""What has curves in a vehicle: of its dampers and springs, and its adjustable dampers, on its linear model or left out of it.

With y what such a force f is over, the velocity or deflection of a suspension, x the states and z_r the road's heights,

    f = w (l y + p(y)),    y = Y x,

where p is what a curve has beyond its line (`models.suspension`). Of a curve w is 1 and l is 0, its line being the linear
model's; of an adjustable damper l is 1 and w its coefficient beyond the nominal one; p it has where it has two curves
(`models.suspension.damper`).

Left out: Adjustable dampers have actuators that push in their places, so that every force is given that is asked for. A curve
that is straight about rest stays, and a small enough road meets its line alone. Of one that bends at rest, by a kink or by
friction, no road is small enough: there the line has the curve's place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.linear_model import LinearModel
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.suspension.curve import Curve


def bent_at_rest(vehicle: Vehicle) -> tuple[str, ...]:
    """The parameters whose curves are not straight about rest, in the order of the suspensions."""
    return tuple(dict.fromkeys(one.parameter for one in vehicle.fitted if (one.curve.pieces.start == 0).any()))


def at_rest(vehicle: Vehicle) -> Vehicle:
    """The vehicle that is linear on roads that are small enough."""
    return vehicle.pushing.straight if bent_at_rest(vehicle) else vehicle.pushing


def at_rest_words(vehicle: Vehicle) -> str:
    """What of a vehicle MuJoCo runs otherwise there; empty where nothing."""
    bent, words = bent_at_rest(vehicle), []
    if vehicle.dampers:
        words.append("actuators that push in place of the adjustable dampers, so that every force is given")
    if bent:
        one = "curve of" if len(bent) == 1 else "curves of"
        whose = " and ".join(name.replace("_", " ") for name in bent)
        words.append(f"lines in place of the {one} {whose}, which {'bends' if len(bent) == 1 else 'bend'} at rest")
    return f"MuJoCo has {' and '.join(words)}" if words else ""


@dataclass(frozen=True, eq=False)
class Elements:
    """What has curves, or is an adjustable damper, e of them, on a linear model of n states and p outputs.

    Attributes:
        curves: whose pieces each has; None for none.
        lines: l of each, shape (e,).
        rows, of_road: from the states, and from the road's heights, to what each force is over, shapes (e, n) and (e, r).
        push: what each, as it pulls together, does to the states, shape (n, e).
        outputs: and to the output signals, shape (p, e); 0 of an adjustable damper, whose force is an input.
    """

    curves: "tuple[Curve | None, ...]"
    lines: Array
    rows: Array
    of_road: Array
    push: Array
    outputs: Array


def is_curved(vehicle: Vehicle) -> bool:
    """Whether a suspension of the vehicle has a curve that is not straight."""
    return any(len(one.curve.pieces.slope) for one in vehicle.fitted)


def elements(vehicle: Vehicle, model: LinearModel) -> Elements:
    """The curves of a vehicle on its linear model, or on a larger one with the same outputs, whose first states are its own.

    Args:
        vehicle: the vehicle.
        model: the linear model.
    """
    curved = [one for one in vehicle.fitted if len(one.curve.pieces.slope)]
    velocities = {one.deflection: one.velocity.name for one in vehicle.kind.suspensions}
    over = [velocities[one.deflection] if one.damps else one.deflection for one in curved]
    index = [model.outputs.index(name) for name in over]
    push, outputs = _pulls(vehicle, [one.deflection for one in curved])
    push = np.vstack([push, np.zeros((len(model.A) - len(push), len(curved)))])
    rows, lines = model.C[index], np.zeros(len(curved))
    return Elements(tuple(one.curve for one in curved), lines, rows, model.Cr[index] + rows @ model.Bw, push, outputs)


def with_dampers(curved: Elements, vehicle: Vehicle) -> Elements:
    """The same with the adjustable dampers of a vehicle behind them, on its own linear model."""
    from sim.linear.dampers import stretching

    model, some = vehicle.linear_model, adjustable_inputs(vehicle)
    rows = stretching(vehicle)[some]
    return Elements(
        (*curved.curves, *(None if one.damper.pair is None else one.damper.pair.shape for one in vehicle.adjustable)),
        np.concatenate([curved.lines, np.ones(len(some))]),
        np.concatenate([curved.rows, rows]),
        np.concatenate([curved.of_road, rows @ model.Bw]),
        np.concatenate([curved.push, -model.B[:, some]], axis=1),
        np.concatenate([curved.outputs, np.zeros((len(model.C), len(some)))], axis=1),
    )


def adjustable_inputs(vehicle: Vehicle) -> list[int]:
    """Which inputs of the linear model are adjustable dampers."""
    return [vehicle.linear_model.inputs.index(one.force) for one in vehicle.adjustable]


def _pulls(vehicle: Vehicle, deflections: Sequence[str]) -> tuple[Array, Array]:
    """What forces that pull suspensions together do to states and outputs, shapes (n, e) and (p, e).

    That of a suspension without an actuator follows from what a parameter of its spring or damper does.
    """
    model, kind = vehicle.linear_model, vehicle.kind
    of = {one.deflection: one for one in kind.suspensions}
    push, outputs = np.zeros((len(model.A), len(deflections))), np.zeros((len(model.C), len(deflections)))
    for j, name in enumerate(deflections):
        force = of[name].force
        if force in model.inputs:
            i = model.inputs.index(force)
            push[:, j], outputs[:, j] = -model.B[:, i], -model.D[:, i]
            continue
        parameter = of[name].stiffness
        stretched = [one.deflection for one in kind.suspensions if one.stiffness == parameter]
        more = kind.model({**vehicle.parameters, parameter: 2 * vehicle.parameters[parameter]})
        by = np.linalg.pinv(model.rows(stretched)[0]) / vehicle.parameters[parameter]
        push[:, j] = ((more.A - model.A) @ by)[:, stretched.index(name)]
        outputs[:, j] = ((more.C - model.C) @ by)[:, stretched.index(name)]
    outputs[[model.outputs.index(name) for name in model.inputs]] = 0.0  # of which the curve's is none
    return push, outputs
