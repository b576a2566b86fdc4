"""Controllers over the vehicles that logs allow: the worst certified bound, margin and ride on the ellipse of parameters.

The 95 % ellipse of the logarithms of p estimated parameters has 2 p ends of axes, so there are 2 p + 1 vehicles with
the estimate. Each controller is designed for the estimate, and certified on every one of them in exact arithmetic. The bound is
proved for these vehicles, and not between them.
"""

from collections.abc import Sequence
from math import inf

import numpy as np

from models.vehicle.vehicle import Vehicle
from sim.studies.identification.allowed_result import AllowedResult
from sim.studies.identification.identification import Identification, changed

LEVEL = 0.95  # probability of the ellipse


def allowed_vehicles(of: Identification) -> list[Vehicle]:
    """Returns the estimated vehicle and those at the ends of the axes of the ellipse that the logs allow."""
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
    """Returns the results of controllers over the vehicles that the logs allow.

    Args:
        names: controllers with a linear law; by default all of the vehicle file.
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
