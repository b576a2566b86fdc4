"""Quantities of a vehicle at its wheels: linear model with forces at the wheels, effect of suspension forces, and spring and
damper rates.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.kinds.kind import Parameters, VehicleKind
from models.kinds.linear_model import LinearModel


def wheel_model(kind: VehicleKind, parameters: Parameters) -> LinearModel:
    """Returns the linear model whose inputs are the forces at the wheels; each force at a wheel is an actuator force times its
    motion ratio.
    """
    return kind.model(kind.at_wheels(parameters))


def force_effects(kind: VehicleKind, parameters: Parameters, deflections: Sequence[str]) -> tuple[Array, Array]:
    """Returns the effect of suspension forces on the states and outputs.

    A positive force pulls body and wheel together. For a suspension without an actuator, the effect is computed from a change
    of its spring or damper parameter.

    Returns:
        Effects of e suspension forces on the derivatives of the n states, shape (n, e), and on the p outputs, shape (p, e).
    """
    model, parameters = wheel_model(kind, parameters), kind.at_wheels(parameters)
    suspensions = {suspension.deflection: suspension for suspension in kind.suspensions}
    push, outputs = np.zeros((len(model.A), len(deflections))), np.zeros((len(model.C), len(deflections)))
    for j, name in enumerate(deflections):
        force = suspensions[name].force
        if force in model.inputs:
            i = model.inputs.index(force)
            push[:, j], outputs[:, j] = -model.B[:, i], -model.D[:, i]
            continue
        parameter = suspensions[name].stiffness
        stretched = [suspension.deflection for suspension in kind.suspensions if suspension.stiffness == parameter]
        more = kind.model({**parameters, parameter: 2 * parameters[parameter]})
        by = np.linalg.pinv(model.rows(stretched)[0]) / parameters[parameter]
        push[:, j] = ((more.A - model.A) @ by)[:, stretched.index(name)]
        outputs[:, j] = ((more.C - model.C) @ by)[:, stretched.index(name)]
    # The measured force of an actuator does not include the forces of suspension parts.
    outputs[[model.outputs.index(name) for name in model.inputs]] = 0.0
    return push, outputs


def ratio_notes(kind: VehicleKind, given: Parameters) -> list[str]:
    """Returns notes, one for each motion ratio, with the spring and damper rates at the wheel; empty if no suspension has a
    motion ratio.
    """
    wheel, notes = kind.at_wheels(given), dict[str, None]()
    for part in kind.suspensions:
        if part.ratio in given and wheel.get(part.ratio) != given[part.ratio]:
            units = ((part.stiffness, "N/m"), (part.damping, "N s/m"))
            rates = " and ".join(f"{wheel[name]:g} {unit}" for name, unit in units if name in wheel)
            where = " at equilibrium" if part.ratio in kind.ratios else ""
            notes[f"{part.ratio} {given[part.ratio]:g}{where}: {rates} at the wheel"] = None
    return list(notes)
