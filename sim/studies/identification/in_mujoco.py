"""Independent check of the prediction, in which the identified vehicle is simulated in MuJoCo over the road of an experiment."""

from dataclasses import replace

import numpy as np

from models.roads.rig import Rig
from sim.studies.identification.estimation.estimate import Estimate

TIMESTEP = 1e-3  # s, largest timestep in MuJoCo
MOST = 60.0  # s, longest part of an experiment that is simulated in MuJoCo


def difference_in_mujoco(of: Estimate) -> dict[str, float]:
    """Returns the largest difference of each signal between MuJoCo and the prediction in the first experiment, relative to the
    signal's peak.

    The result is empty if the experiment cannot be simulated, because control forces act, a part is on a dyno, or the road is
    unknown.
    """
    from sim.runs.run import run_controllers
    from synth.vehicle.designer import design

    one, prediction = of.problem.experiments[0], of.problem.predictions[0]
    if one.hubs or one.part or one.forces.any():
        return {}
    count, steps = min(len(one.road), round(MOST / one.step)), max(1, int(np.ceil(one.step / TIMESTEP - 1e-9)))
    vehicle = prediction.vehicle(of.values)
    if (start := of.residuals.start(of.x, 0)) is not None:
        vehicle = replace(vehicle, start=dict(zip(vehicle.linear_model.states, start.tolist(), strict=True)))
    shift = of.residuals.shifts(of.x, 0)
    posts = tuple(wheel.road_displacement for wheel in vehicle.kind.wheels)
    fine = one.step / steps * np.arange((count - 1) * steps + 1)
    heights = np.stack([np.interp(fine, one.step * np.arange(count), column[:count]) for column in one.road.T], axis=-1)
    (run,) = run_controllers(vehicle, [design(vehicle, "passive")], Rig(fine, heights, posts), fine, balanced=False)
    each = dict[str, float]()
    for i, channel in enumerate(one.channels):
        delay = of.delays.get(channel.signal, channel.delay)
        values = run.physics[channel.signal]
        there = np.interp(one.step * np.arange(count) - delay, fine, values, left=np.nan)
        predicted = of.predicted[0][:count, i] - shift[i]
        peak = float(np.nanmax(np.abs(predicted)))
        each[channel.signal] = float(np.nanmax(np.abs(there - predicted))) / peak if peak else 0.0
    return each
