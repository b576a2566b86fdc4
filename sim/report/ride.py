"""The ride section of a report: random roads of several classes, MuJoCo beside what the spectrum predicts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.vehicle import Vehicle
from sim.figures.page import Section, Table
from sim.physics.simulate import simulate
from sim.report.scope import joined
from sim.response.regime import FLAT, REGIME_ENDS, reached
from sim.ride.expected import expect, settling_time
from sim.ride.metrics import dynamic_load, measure, off_ground, points
from sim.roads.iso8608 import Iso8608, long_enough
from sim.roads.road import track_width
from sim.runs.run import sample_times
from synth.controller import Controller

CLASSES, SPEED, SEEDS = "ABCD", 20.0, (0, 1, 2, 3)  # speed in m/s
WINDOW = 10.0  # s, in which is measured, once the loop has forgotten that it began from rest
LONGEST = 20.0  # s; more than that no loop is waited for


def ride_section(vehicle: Vehicle, controllers: Sequence[Controller], timestep: float) -> Section:
    """Every controller over every class, root mean square over the seeds."""
    found = [row for one in controllers for row in _rows(vehicle, one, timestep)]
    names = ("class", "controller", "metric", "unit", "MuJoCo", "predicted", "road to road", "lift-off")
    rows = sorted(found, key=lambda row: (row[0], row[2]))
    return Section("Ride", (ride_text(vehicle),), (Table("ride", names, tuple(rows), words=4),))


def ride_text(vehicle: Vehicle) -> str:
    """What the table of ride is of, and what its predictions leave out."""
    ends, blur = replace(vehicle.limits, actuator_bandwidth=None), replace(vehicle.implementation, sample_period=None, delay=0)
    left_out = joined([*ends.words, *blur.words])
    return (
        f"Random roads of ISO 8608 at {SPEED:g} m/s, {len(SEEDS)} of each class, {WINDOW:g} s each. Weighted is ISO 2631-1's rms "
        "acceleration, Wk; dynamic load is the rms of the tyre's force over its static value; lift-off is the largest share of "
        "time that a tyre is off one of these roads. Predicted is from the road's spectrum through the sampled linear loop"
        f"{f', which leaves out {left_out}' if left_out else ''}. Both are roots of mean squares, over the roads driven and over "
        "all roads; road to road is by how much one such road differs from that, one standard deviation, so MuJoCo's differs by "
        "half of it. Runs that diverged or squeezed a tyre flat are left out."
    )


def _rows(vehicle: Vehicle, controller: Controller, timestep: float) -> list[tuple[str, ...]]:
    start = min(settling_time(vehicle, controller), LONGEST)
    time = sample_times(vehicle, start + WINDOW, timestep)
    first = round(start / timestep)
    length, width = long_enough(SPEED * float(time[-1])), track_width(vehicle)
    roads = [Iso8608(name, seed, SPEED, width, length) for name in CLASSES for seed in SEEDS]
    count = len(roads)
    physics = simulate([vehicle] * count, [controller] * count, roads, time, threads=0)
    response = physics.response
    ended = np.minimum(physics.diverged, reached(vehicle, response)[:, REGIME_ENDS.index(FLAT)])
    measured = [measure(vehicle, response.run(i), first) for i in range(count)]
    ideal = replace(vehicle, implementation=replace(vehicle.implementation, noise={}, quantisation={}))

    where, rows = points(vehicle), []
    metrics = [(f"{name}_weighted", "m/s2") for name in where.accelerations]
    metrics += [(f"{name}_rms", "m") for name in where.suspensions]
    metrics += [(dynamic_load(name), "-") for name in where.tyres]
    metrics += [(f"{name}_rms", "N") for name, *_ in where.actuators if np.any(controller.gain)]
    for k, road_class in enumerate(CLASSES):
        runs = range(k * len(SEEDS), (k + 1) * len(SEEDS))
        some = [measured[i] for i in runs if np.isinf(ended[i])]
        expected = expect(ideal, controller, roads[k * len(SEEDS)].spectrum, timestep, WINDOW)
        lifted = max((one[off_ground(tyre)] for one in some for tyre in where.tyres), default=0.0)
        events = f"{100 * lifted:.2f} %" if lifted else "none"
        if len(some) < len(SEEDS):
            events = f"{len(SEEDS) - len(some)} of {len(SEEDS)} flat or diverged" + (f", else {events}" if some else "")
        for name, unit in metrics:
            mean, spread = (expected.mean[name], expected.spread.get(name)) if expected else (None, None)
            rows.append(
                (
                    road_class,
                    controller.name,
                    name.replace("_", " "),
                    unit,
                    f"{np.sqrt(np.mean([one[name] ** 2 for one in some])):.4g}" if some else "-",
                    f"{mean:.4g}" if mean is not None else "-",
                    f"+-{100 * spread / mean:.0f} %" if mean and spread is not None else "-",
                    events,
                )
            )
    return rows
