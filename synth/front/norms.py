"""The norm of a law on an axis, proved, and the landscapes of the gains that it is searched over."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.controllers import ControllerEntry
from models.law import LinearLaw
from models.vehicle import Vehicle
from synth.band.norm import norm_in_band
from synth.designs.goal_problem import weighing
from synth.front.axes import Axis
from synth.goals.banded import BandLandscape
from synth.goals.problem import Errors, Posed
from synth.numerics import numerics
from synth.problem.problem import Problem, problem
from synth.search.landscape import Landscape
from synth.tolerance.worst import worst_norm

MOST_READINGS = 4  # with errors: all their corners count


@dataclass(frozen=True)
class Norm:
    """A law on one axis.

    Attributes:
        value: the norm.
        proved: what it is proved to lie below.
        at: where it is reached [rad/s]; NaN of one with errors.
    """

    value: float
    proved: float
    at: float


@numerics()
def norm_on(vehicle: Vehicle, axis: Axis, entry: ControllerEntry, law: LinearLaw) -> Norm:
    """A law on an axis; infinite where its loop, or one with errors, is unstable."""
    posed = _posed(vehicle, axis, entry)
    if axis.off and len(entry.measured):
        found = worst_norm(posed.plant, posed.Cy, law, axis.off, 0.0, posed.Dyw, posed.through)
        return Norm(found.found, found.proved, float("nan"))
    plant, G = posed.closed(law)
    band = norm_in_band(plant.closed_loop(G), *axis.norm.rates)
    if not band.stability.stable:
        return Norm(np.inf, np.inf, float("nan"))
    return Norm(band.value, band.level if band.value else 0.0, band.peak_frequency)


def _posed(vehicle: Vehicle, axis: Axis, entry: ControllerEntry) -> Problem:
    return problem(weighing(vehicle, axis.norm), entry.measured, entry.hardware)


def landscapes(vehicle: Vehicle, axis: Axis, entry: ControllerEntry, like: Landscape) -> list[BandLandscape]:
    """Those whose largest norm an axis is: one for every corner of its errors, whose points are those of another one.

    Raises:
        InputError: there are too many.
    """
    own = _posed(vehicle, axis, entry)
    plain, (m, _) = Posed(own.plant, own.Cy, own.Dyw), like.shape
    off = (Errors(errors, np.zeros(m)).on(plain) for errors in _corners(axis, len(own.Cy)))
    return [BandLandscape(each.plant, each.Cy, each.Dyw, axis.norm.rates, like) for each in off]


def _corners(axis: Axis, readings: int) -> list[Array]:
    """The errors of readings that an axis is judged with, none first."""
    if not axis.off:
        return [np.zeros(readings)]
    if readings > MOST_READINGS:
        raise InputError(
            f"--front {axis.name} takes a controller of at most {MOST_READINGS} readings, and this one has {readings}; leave "
            f"{axis.name} out, or give another with --controller"
        )
    return [np.zeros(readings), *(axis.off * np.array(signs) for signs in product((-1.0, 1.0), repeat=readings))]
