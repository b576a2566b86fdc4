"""Estimates how the unknown road before the start of a measured road affects the peaks of a run.

A simulated vehicle starts in steady motion on the plane that is fitted to the first 11 m of the road. In reality, the vehicle
comes from a road that was not measured. The road that was not measured may be as rough as the measured road. The unknown road
is modelled as the measured road, rotated by 180 degrees about its first point. The unknown road therefore joins the measured
road without a jump or a kink. The state in which the vehicle arrives from the unknown road is computed without control. The
difference between the arrival state and the steady motion affects the run until it has decayed in the closed loop.
"""

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from models.common.printed import percent, wrap_text
from models.roads.profile import Profile
from models.roads.road import Departure, RoadInput
from sim.linear.forced_response import forced_response
from sim.linear.rounding import roundings
from sim.observers.results import WHEN
from sim.runs.result import RunResult

RUN_IN = 10.0  # s; longest time for which the vehicle drives over the rotated road
SAID_SHARE = 0.02  # an effect on a peak is reported if it exceeds this fraction of the peak
# An effect counts as zero if it is smaller than this multiple of the rounding error of its state or signal
ROUNDING_FACTOR = 1e3


def start_effect(runs: Sequence[RunResult]) -> tuple[float, str] | None:
    """Returns the largest effect of the initial state on a peak of a weighted signal, as a fraction of this peak, and a text
    that describes the peak.

    Returns None if the effect is at most 2 %.
    """
    felt, vehicle = runs[0].prediction.input.relative_road, runs[0].vehicle
    road = felt.road if isinstance(felt, Departure) else None
    turned = road.turned(RUN_IN * road.speed) if isinstance(road, Profile) else None
    if road is None or turned is None:
        return None
    model, h = vehicle.linear_model, runs[0].prediction.timestep
    on = RoadInput(vehicle, turned, np.arange(max(round(turned.duration / h), 1) + 1) * h)
    before = forced_response(np.zeros((len(on.time), len(model.inputs))), on)
    steady = RoadInput(vehicle, road, on.time).steady_signals(np.zeros(1))
    assert steady is not None, "it is a measured road"
    names = [signal.name for signal in vehicle.kind.signals]
    apart = np.array([before[name][-1] - steady[0, names.index(name)] for name in model.states])
    rounding = roundings(vehicle, None)
    apart[np.abs(apart) <= ROUNDING_FACTOR * np.array([rounding[name] for name in model.states])] = 0.0
    effects = [(0.0, "")]
    for run in runs:
        A, C, loop = model.A, model.C, run.prediction.loop
        physics = run.physics.until(max(run.broke_off[1], h) if run.broke_off else np.inf)
        least = roundings(vehicle, run.controller)
        if loop is not None:
            A, C = loop.closed_loop.A, loop.closed_loop.C
        state = np.pad(apart, (0, len(A) - len(apart)))
        for signal in (name for name, weight in vehicle.performance.items() if weight and name in model.outputs):
            k = int(np.abs(physics[signal]).argmax())
            left = float(np.abs(C[model.outputs.index(signal)] @ linalg.expm(A * (k * h)) @ state))
            # A smaller peak is only a rounding error, as in a run without motion
            if (peak := float(physics.peak(signal))) > ROUNDING_FACTOR * least[signal]:
                effects.append((left / peak, f"the peak of {run.controller.name}'s {signal} at {WHEN.text(k * h)}"))
    worst = max(effects)
    return worst if worst[0] > SAID_SHARE else None


def start_lines(runs: Sequence[RunResult], later: bool) -> list[str]:
    """Returns a remark on the effect of the initial state on a peak if this effect exceeds 2 %.

    Args:
        later: True if the runs start after the beginning of the measured road, so that they could also start earlier.
    """
    effect = start_effect(runs)
    if effect is None:
        return []
    share, peak = effect
    return wrap_text(
        f"remark: the unknown road before the start could change {peak} by {percent(share)}; "
        f"start {'earlier or ' if later else ''}elsewhere with --from"
    )
