"""Law for a plant with gain errors: a gain between factors for the measurements and factors for the forces, and the box of
errors.
"""

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw, static_law
from synth.analysis.uncertainty_box import Box, ScaledGain
from synth.plant.discrete import continuous_image
from synth.plant.generalized import Plant, law_gain, real_matrix


def scaled_gain(plant: Plant, law: Array | LinearLaw) -> ScaledGain:
    """Returns the loops of a law as a function of factors that multiply its measurements and forces. The states of the law have
    no errors.

    Args:
        plant: generalised plant with n states, m inputs and q measurements; continuous or discrete, like the law. Only a
            continuous plant may have Dyu.
        law: gain K of u = K y, shape (m, q), or a law with k states.

    Raises:
        InputError: a matrix has the wrong shape, or an entry is not a finite real number.
    """
    plant = plant.measured()
    q, m = plant.Dyu.shape
    law = law if isinstance(law, LinearLaw) else static_law(real_matrix(law, "K", f"({m}, {q})"))
    if law.D.shape != (m, q):
        raise InputError(f"K has shape {law.D.shape}; expected {(m, q)}: a row per input, a column per measured signal")
    image, K0 = continuous_image(plant.with_states(law.states))
    return ScaledGain(image, law_gain(law), K0, q, m)


def box_of(gain: ScaledGain, d: Array | float, e: Array | float) -> Box:
    """Returns the box of factors for relative errors of up to +-d in the measurements and +-e in the forces.

    The errors are independent of one another. The factor of an unused measurement or force is 1.

    Args:
        gain: loop with q measurements and m forces, in addition to the states of a law.
        d: largest relative error of all measurements, or of each measurement, shape (q,).
        e: largest relative error of all forces, or of each force, shape (m,).

    Raises:
        InputError: there are too many errors, or an error is not between 0 and 1.
    """
    (rows, columns), q, m = gain.K.shape, gain.readings, gain.forces
    width = np.zeros(columns + rows)
    width[:q] = _tolerance(d, q, "d of measurements") * np.any(gain.K[:, :q], axis=0)
    width[columns : columns + m] = _tolerance(e, m, "e of forces") * np.any(gain.K[:m], axis=1)
    return Box(1 - width, 1 + width)


def errors_of(gain: ScaledGain, factors: Array) -> tuple[Array, Array]:
    """Returns the relative errors of measurements and forces for given factors, shapes (q,) and (m,)."""
    start = gain.K.shape[1]
    return factors[: gain.readings] - 1, factors[start : start + gain.forces] - 1


def _tolerance(value: Array | float, count: int, of: str) -> Array:
    try:
        width = np.array(np.broadcast_to(np.asarray(value, dtype=float), count))
    except (TypeError, ValueError):
        raise InputError(f"the tolerance {of} has shape {np.shape(value)}; give a single number for all, or {count}") from None
    if not np.all((width >= 0) & (width <= 1)):
        raise InputError(f"a tolerance {of} is {value}; give relative errors from 0 to 1 (0.1 is 10 %)")
    return width
