"""A plant from a `control.StateSpace` with named signals; any object with its attributes will do."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, known
from synth.plant import GeneralizedPlant


def from_state_space(
    system: Any, disturbances: Sequence[str], performance: Mapping[str, float], measured: Sequence[str]
) -> tuple[GeneralizedPlant, Array]:
    """The plant (15) and C_y of a continuous-time system whose signals have names.

    Args:
        system: `control.StateSpace`: A, B, C, D, input_labels, output_labels.
        disturbances: the inputs that are w; all others are u.
        performance: weights of the outputs that make z, by name.
        measured: the outputs that make y. None of them may contain u or w.

    Returns:
        The plant, and C_y of shape (q, n).

    Raises:
        InputError: an unknown signal, no disturbance, no weight above zero, nothing measured, a sampled system, or a measurement
            that contains u or w.
    """
    if getattr(system, "dt", 0):
        raise InputError(f"the system is sampled (dt = {system.dt}); give a continuous-time one")
    inputs, outputs = list(system.input_labels), list(system.output_labels)
    for what, asked, there in (
        ("disturbance", disturbances, inputs),
        ("performance signal", performance, outputs),
        ("measured signal", measured, outputs),
    ):
        for name in asked:
            if name not in there:
                raise InputError(f"unknown {what} {name!r}; the system has {known(there)}")
    if not disturbances:
        raise InputError(f"no disturbance is named; give at least one of the inputs {known(inputs)}")
    weights = {name: float(weight) for name, weight in performance.items() if weight != 0}
    if not weights:
        raise InputError(f"the weights are all zero; give at least one weight to the outputs {known(outputs)}")
    if not measured:
        raise InputError(f"nothing is measured; give at least one of the outputs {known(outputs)}")
    w = [inputs.index(name) for name in disturbances]
    u = [i for i in range(len(inputs)) if i not in w]
    z, y = [outputs.index(name) for name in weights], [outputs.index(name) for name in measured]
    A, B, C, D = (np.array(getattr(system, name), dtype=float) for name in "ABCD")
    for name, row in zip(measured, D[y], strict=True):
        if np.any(row):
            raise InputError(f"measured signal {name!r} contains an input directly; a static controller measures states only")
    weight = np.array(list(weights.values()))[:, None]
    plant = GeneralizedPlant(A, B[:, u], B[:, w], weight * C[z], weight * D[np.ix_(z, u)], weight * D[np.ix_(z, w)])
    return plant, C[y]
