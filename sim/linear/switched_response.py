"""Response of a linear vehicle whose adjustable dampers give the forces of a linear law as far as they can.

At every sample the law requests forces, and each damper takes the coefficient within its range that comes next to its force. The
coefficient acts from then on, through the lag of its valve. Between samples the vehicle is linear except for the characteristics
of its dampers and springs, and RK4 integrates it, as MuJoCo does. No limit of travel or force acts, so that without such
characteristics and loads the response is proportional to the road.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from models.common.arrays import Array
from models.laws.anti_windup import anti_windup_gain
from models.parts.damper_range import range_of
from models.roads.road import RoadInput
from models.vehicle.limits_and_implementation import Limits, steps_per_sample
from sim.linear.dampers import damper_signals, stretching
from sim.linear.linear_motion import LinearMotion, lag_rates, suspension_pulls
from sim.response.recursion import SHARES, WEIGHTS
from sim.response.response import Response
from synth.controller.controller import Controller


def switched_response(controller: Controller, inputs: Sequence[RoadInput]) -> Response:
    """Returns the responses from rest, values of shape (N, T, S).

    Args:
        controller: a linear controller, whose measurements are taken without noise.
        inputs: N roads under one vehicle with adjustable dampers, at the same sample times.
    """
    vehicle, time, h = replace(inputs[0].vehicle, limits=Limits()), inputs[0].time, inputs[0].timestep
    model, motion, forces = vehicle.linear_model, LinearMotion(vehicle), vehicle.linear_model.inputs
    how, of, V = vehicle.implementation, range_of([vehicle.adjustable], vehicle.linear_model.inputs), stretching(vehicle)
    period, m, count, samples = steps_per_sample(how, h), len(forces), len(inputs), len(time)
    law, late = controller.law.sampled(period * h), round(how.delay * period)
    windup = None if law.anti_windup is None else anti_windup_gain(law)
    heights, midway, loads = (np.stack([getattr(one, name) for one in inputs], 1) for name in ("heights", "midway", "held"))
    acted, read = (np.stack([getattr(one, name) for one in inputs], 1) for name in ("in_signals", "in_readings"))
    rates = lag_rates(vehicle)
    dampers, at_rest = np.isin(forces, list(vehicle.dampers)), np.array([*vehicle.motion_ratios.values()])
    xi, kept = np.zeros((count, len(model.A))), np.zeros((count, law.states))
    acting, command, waiting = np.zeros((count, m)), np.zeros((count, 2 * m)), dict[int, Array]()
    states, given, missing = (np.zeros((samples, count, width)) for width in (len(model.A), m, m))

    def terms(acting: Array, ratios: Array) -> tuple[Array, partial[Array]]:
        """Returns the forces of actuators that push, at the wheels, and the pulls of the suspensions."""
        beyond = np.where(dampers, acting, 0.0)
        return np.where(dampers, 0.0, acting) * ratios, partial(suspension_pulls, vehicle, beyond, ratios)

    for k in range(samples):
        x = xi + heights[k] @ model.jump.T
        ratios = vehicle.ratios_along(dict(zip(model.states, x.T, strict=True)).__getitem__)
        if k % period == 0:  # a reading contains the forces that acted until then
            pushed, pulls = terms(acting, ratios)
            shown = dict(zip(forces, (pushed / ratios).T, strict=True))
            shown |= motion.outputs(xi, heights[k], pushed, pulls, read[k])
            y = np.stack([shown[name] for name in controller.measured], axis=1) if controller.measured else np.zeros((count, 0))
            closing = (np.where(of.adjustable, -(x @ V.T), 0.0) + of.at_rest) * (ratios / at_rest)
            requested = y @ law.D.T + kept @ law.C.T
            kept = y @ law.B.T + kept @ law.A.T
            if windup is not None:
                kept = kept + of.clipped_off(requested, closing) @ windup.T
            waiting[k + late] = of.commands(np.concatenate([requested, closing], axis=1))
        command = waiting.pop(k, command)
        target = command[:, :m]
        acting = np.where(rates > 0, acting, target)
        states[k], given[k], missing[k] = xi, acting, command[:, m:]
        total = rate = np.zeros_like(xi)
        change = turn = np.zeros_like(acting)
        for share, weight in zip(SHARES, WEIGHTS, strict=True):
            at, now = xi + share * h * rate, acting + share * h * turn
            rate, turn = motion.rate(at, midway[k], *terms(now, ratios), loads[k]), rates * (target - now)
            total, change = total + weight * rate, change + weight * turn
        xi, acting = xi + h * total, acting + h * change
    signals = vehicle.kind.signals
    responses = []
    for i, road in enumerate(inputs):
        x = states[:, i] + heights[:, i] @ model.jump.T
        values = dict(zip(model.states, x.T, strict=True))
        ratios = vehicle.ratios_along(values.__getitem__)
        pushed, pulls = terms(given[:, i], ratios)
        speeds = dict(zip(forces, ((x @ V.T) * (ratios / at_rest)).T, strict=True))
        values |= motion.outputs(states[:, i], heights[:, i], pushed, pulls, acted[:, i])
        values |= dict(zip(forces, (pushed / ratios).T, strict=True))
        values |= damper_signals(vehicle, np.where(dampers, given[:, i], 0.0), missing[:, i])
        for one in vehicle.adjustable:
            values[one.force] = -given[:, i, forces.index(one.force)] * one.shape(speeds[one.force])
        for j, wheel in enumerate(vehicle.kind.wheels):
            values |= {wheel.road_displacement: heights[:, i, j], wheel.road_velocity: road.velocities[:, j]}
        for name, parts in vehicle.kind.combined.items():
            values[name] = sum((share * values[part] for part, share in parts.items()), np.zeros(samples))
        steady, stacked = road.steady_signals(time), np.stack([values[signal.name] for signal in signals], axis=-1)
        responses.append(stacked if steady is None else stacked + steady)
    return Response(time, signals, np.stack(responses))
