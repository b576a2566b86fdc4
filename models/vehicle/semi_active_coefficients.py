"""Coefficients of semi-active control laws for the vehicles on which these laws act."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.laws.semi_active import CROSSOVER, MODAL, SPRUNG, LawCoefficients, SemiActiveLaw
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.parts.damper_range import CoefficientRange


def numbers_of(laws: Sequence[SemiActiveLaw], vehicles: Sequence[Vehicle]) -> LawCoefficients:
    """Returns the coefficients of N semi-active laws with the same name, for N vehicles of one type.

    By default, the virtual damper between body and sky, or between wheel and ground, has the coefficient c_max at the wheel. By
    default, the damper between a body mode and the sky has the same coefficient as the sky damper.
    """
    dampers = [[damper.damper for damper in vehicle.parts.adjustable] for vehicle in vehicles]
    c_min, c_max = (np.array([[getattr(damper, name) for damper in row] for row in dampers]) for name in ("c_min", "c_max"))
    given = [dict(law.numbers) for law in laws]

    def of(key: str, otherwise: Array | float) -> Array:
        numbers = np.broadcast_to(otherwise, c_max.shape).astype(float)
        for i, one in enumerate(given):
            if key in one:
                numbers[i] = one[key]
        return numbers

    squares = np.array([[damper.ratio for damper in vehicle.parts.adjustable] for vehicle in vehicles]) ** 2
    # Damping coefficients of the dampers at the body and at the wheel
    sky, ground = of("sky_damping", c_max * squares), of("ground_damping", c_max * squares)
    moved = np.stack([_modes(law, vehicle) for law, vehicle in zip(laws, vehicles, strict=True)], axis=1)
    damped = moved.copy()
    for b, key in enumerate(key for key, mode in MODAL.items() if mode in laws[0].modes):
        for i, one in enumerate(given):
            if key in one:
                damped[b, i] *= one[key] / np.where(sky[i] > 0, sky[i], 1.0)
    stiffness = np.array([_stiffness(vehicle) for vehicle in vehicles])
    mix, crossover = of("mix", 0.5), of("crossover", CROSSOVER)
    return LawCoefficients(c_min, c_max, sky / squares, ground / squares, stiffness, ([*damped], [*moved]), mix, crossover)


def _stiffness(vehicle: Vehicle) -> list[float]:
    """Returns the stiffness of each suspension with a semi-active damper [N/m]; 0 if the vehicle type has no such parameter."""
    parameters = {one.force: one.stiffness for one in vehicle.kind.suspensions}
    return [vehicle.parameters.get(parameters[one.force], 0.0) for one in vehicle.parts.adjustable]


def _modes(law: SemiActiveLaw, vehicle: Vehicle) -> Array:
    """Returns the factors by which the velocities of b body modes contribute to the body's velocities at m suspensions, shape
    (b, m).
    """
    if not law.modes:
        return np.zeros((0, len(law.endings)))
    model = vehicle.linear_model
    rows, _ = model.rows([f"{SPRUNG}{ending}" for ending in law.endings])
    return rows[:, [model.states.index(mode) for mode in law.modes]].T


def numbers_at(numbers: LawCoefficients, of: "CoefficientRange", closing: Array, which: Array | slice) -> LawCoefficients:
    """Returns the coefficients of semi-active laws, with the limits that nonlinear dampers have at the closing velocities.

    Args:
        numbers: coefficients of the laws for linear dampers.
        of: ranges of the damping coefficients that the dampers of N vehicles can have.
        closing: closing velocity of each suspension [m/s], not 0, shape (..., m).
        which: indices of the selected vehicles among the N vehicles.
    """
    if not of.curved:
        return numbers
    c_min, c_max = of.secant_limits(numbers.c_min, numbers.c_max, closing, which)
    return replace(numbers, c_min=c_min, c_max=c_max)
