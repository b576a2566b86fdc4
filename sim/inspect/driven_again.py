"""A logged run judged again, run by MuJoCo again, and written down again."""

import math
from dataclasses import replace

import numpy as np

from models.common.errors import InputError
from sim.inspect.log import RESPONSES, RecordedRun
from sim.inspect.reproduction import Reproduction, as_response
from sim.linear.loop import driven, noise_spread, sampled_radius
from sim.physics.energy import energy
from sim.physics.simulate import simulate
from sim.recording.provenance import run_log
from sim.recording.run_log import RunLog
from sim.response.response import Response
from sim.runs.agreement import SMALL, compare, look_closer
from sim.runs.run import Run, halved

MOST_STATES = 1000  # of a loop with all its delayed forces; its eigenvalues take seconds


def driven_again(again: Reproduction, physics: Response) -> Run:
    """The verdict on the logged physics, as `sim.runs.run.run_all` reaches it.

    Raises:
        InputError: the loop has too many delayed forces for the spread of its noise.
    """
    vehicle, controller, h = again.vehicle, again.controller, again.timestep
    model, _ = driven(vehicle, controller)
    small = len(model.A) + vehicle.implementation.delay * len(model.inputs) <= MOST_STATES
    noisy = any(vehicle.implementation.noise.values()) or any(vehicle.implementation.quantisation.values())
    if noisy and not small:
        raise InputError("its noise goes through a loop with too many delayed forces to compute its spread again")
    broken = ~np.all(np.isfinite(physics.values), axis=1)
    diverged = float(physics.time[broken.argmax()]) if broken.any() else math.inf
    spread = noise_spread(vehicle, controller, h) if noisy else {}
    agreement = compare(vehicle, physics, again.sampled, again.integrated, again.continuous, diverged, spread)
    if not agreement.agrees and not agreement.blurred:
        lower = simulate([vehicle], [controller], [again.road.scaled(SMALL)], physics.time).response.run(0)
        agreement = look_closer(agreement, lower, again.sampled)
    radius = sampled_radius(vehicle, controller, h) if small else math.nan
    return Run(
        controller, physics, again.sampled, again.continuous, np.zeros((len(physics.time), 0)), diverged, radius, agreement
    )


def balanced_again(again: Reproduction, run: Run) -> tuple[Run, Response]:
    """A run with the energy balance of what MuJoCo makes of it now, and what half the step changes; and that physics."""
    vehicle, road, time = again.vehicle, again.road, run.physics.time
    anew = simulate([vehicle], [again.controller], [road], time)
    run = replace(run, energy=energy(vehicle, anew, 0, road, until=run.agreement.flat), qpos=anew.qpos[0])
    (run,) = halved(vehicle, [run], road, time)
    return run, anew.response.run(0)


def written_again(again: Reproduction, recorded: RecordedRun, run: Run, samples: int) -> RunLog:
    """A run as it would be written now, with the responses that were logged."""
    vehicle = again.vehicle
    responses = {name: as_response(vehicle, recorded, name, samples, again.timestep) for name in RESPONSES}
    return replace(run_log(vehicle, again.road, run, recorded.name), responses=responses)
