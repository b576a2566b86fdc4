"""Coefficients of semi-active laws for the vehicles that they run on."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.laws.semi_active import CROSSOVER, MODAL, SPRUNG, Numbers, SemiActiveLaw
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.suspension.damper_range import Range


def numbers_of(law: SemiActiveLaw, vehicles: Sequence[Vehicle]) -> Numbers:
    """Returns the coefficients of a law for N vehicles of one kind.

    A damper between body and sky, or wheel and ground, has c_max by default; a damper of a mode of the body has the sky damper's
    coefficient by default.
    """
    given = dict(law.numbers)
    dampers = [[damper.damper for damper in vehicle.adjustable] for vehicle in vehicles]
    c_min, c_max = (np.array([[getattr(damper, name) for damper in row] for row in dampers]) for name in ("c_min", "c_max"))
    sky, ground = (np.full_like(c_max, given[name]) if name in given else c_max for name in ("sky_damping", "ground_damping"))
    moved = np.stack([_modes(law, vehicle) for vehicle in vehicles], axis=1)
    damped = moved.copy()
    to_sky = [np.full(len(vehicles), given[key]) if key in given else None for key, mode in MODAL.items() if mode in law.modes]
    for b, coefficient in enumerate(to_sky):
        if coefficient is not None:
            damped[b] *= coefficient[:, None] / np.where(sky > 0, sky, 1.0)
    stiffness = np.array([_stiffness(vehicle) for vehicle in vehicles])
    mix, crossover = given.get("mix", 0.5), given.get("crossover", CROSSOVER)
    return Numbers(c_min, c_max, sky, ground, stiffness, ([*damped], [*moved]), mix, crossover)


def _stiffness(vehicle: Vehicle) -> list[float]:
    """Returns the stiffness of the suspensions with an adjustable damper [N/m]; 0 if the kind names no parameter."""
    parameters = {one.force: one.stiffness for one in vehicle.kind.suspensions}
    return [vehicle.parameters.get(parameters[one.force], 0.0) for one in vehicle.adjustable]


def _modes(law: SemiActiveLaw, vehicle: Vehicle) -> Array:
    """Returns the factors from the velocities of the body's modes to those at the suspensions, shape (b, m)."""
    if not law.modes:
        return np.zeros((0, len(law.endings)))
    model = vehicle.linear_model
    rows, _ = model.rows([f"{SPRUNG}{ending}" for ending in law.endings])
    return rows[:, [model.states.index(mode) for mode in law.modes]].T


def numbers_at(numbers: Numbers, of: "Range", closing: Array, which: Array | slice) -> Numbers:
    """Returns the coefficients with the limits of curved dampers at velocities.

    Args:
        of: what the dampers of N vehicles can be.
        closing: closing velocity of each suspension [m/s], not 0, shape (..., m).
        which: of the N.
    """
    if of.bent is None:
        return numbers
    c_min, c_max = of.seen(numbers.c_min, numbers.c_max, closing, which)
    return replace(numbers, c_min=c_min, c_max=c_max)
