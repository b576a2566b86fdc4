"""Worst bound on the norm, margins and ride of a controller over the vehicles that are consistent with the logs.

The logarithms of the p estimated parameters have a 95 % confidence ellipsoid. Each of the ellipsoid's p axes has two ends, and
each of these 2 p ends corresponds to one vehicle. Together with the estimated vehicle, there are 2 p + 1 vehicles. Each
controller is designed for the estimated vehicle. The controller's bound on the norm is then certified in exact arithmetic for
each of the 2 p + 1 vehicles. Nothing is proved for any other vehicle within the ellipsoid.
"""

from collections.abc import Sequence
from math import inf

import numpy as np

from models.vehicle.vehicle import Vehicle
from sim.studies.identification.allowed_result import AllowedResult
from sim.studies.identification.identification import Identification, changed

LEVEL = 0.95  # probability with which the ellipsoid contains the true parameters


def allowed_vehicles(of: Identification) -> list[Vehicle]:
    """Returns the estimated vehicle and the vehicles at the ends of the axes of the confidence ellipsoid."""
    from scipy.stats import chi2

    estimate = of.estimate
    sizes, axes = np.linalg.eigh(estimate.spread)
    radius = float(np.sqrt(chi2.ppf(LEVEL, len(estimate.free))))
    vehicles = [of.vehicle]
    for size, axis in zip(sizes, axes.T, strict=True):
        for sign in (1, -1):
            moved = np.exp(sign * radius * np.sqrt(max(size, 0.0)) * axis)
            values = {name: estimate.values[name] * float(factor) for name, factor in zip(estimate.free, moved, strict=True)}
            vehicles.append(changed(of.vehicle, values))
    return vehicles


def allowed_results(of: Identification, names: Sequence[str] = ()) -> list[AllowedResult]:
    """Returns the bounds, margins and ride of controllers over the vehicles that are consistent with the logs.

    Args:
        names: names of controllers with a linear law; by default all controllers of the vehicle file with a linear law, except
            `state`.
    """
    from synth.analysis.bounding import certify_tightly
    from synth.controller.law_margins import law_margins
    from synth.vehicle.designer import Designer
    from synth.vehicle.expected_ride import expected_ride

    results, vehicles = list[AllowedResult](), allowed_vehicles(of)
    designers = [Designer(one, search=False) for one in vehicles]
    for name in names or of.vehicle.linear_names:
        if name == "state" and not names:
            continue
        own = designers[0].design(name)
        each = [designer.certify(name, own.measured, own.law, own.hardware) for designer in designers] if own.measured else [own]
        judged = [
            one.problem(vehicle).judged(one.law) if one.measured else None for vehicle, one in zip(vehicles, each, strict=False)
        ]
        bounds = [
            None if one is None else certify_tightly(one.plant, one.G, plant_without_law=one.plant_without_law).bound
            for one in judged
        ]
        margins = [law_margins(vehicle, one) for vehicle, one in zip(vehicles, each, strict=False)]
        rides = [expected_ride(vehicle, one) for vehicle, one in zip(vehicles, each, strict=False)]
        proved, known = [one for one in bounds if one is not None], [one for one in rides if one is not None]
        disks = [one.disk for one in margins if one.disk is not None]
        results.append(
            AllowedResult(
                name,
                bounds[0],
                max(proved) if len(proved) == len(bounds) else None,
                min((one.gain for one in margins), default=inf),
                min(disks, default=None),
                rides[0],
                max(known) if len(known) == len(rides) else None,
                len(each),
            )
        )
    return results
