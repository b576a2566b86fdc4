"""The L2 gain of a vehicle's sampled loop, from the road's continuous velocity to the continuous z.

It is the continuous norm (18) of the loop with `[implementation]` and the lag of `[limits]`: the force is held and delayed, while
road and vehicle move continuously. Nonlinear parts (limits of force and stroke, quantisation) do not count. Noise of the readings
counts if the controller asks for it. Behind a lag, z weights the acting force.
"""

import math

import numpy as np

from models import USUAL_TIMESTEP
from models.common.errors import InputError
from models.vehicle.controllers import NOMINAL, ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.record import SAMPLED_BOUND, read_sampled_bound
from synth.analysis.sampled_loop import SampledDataProblem, SampledLoop, hold_intervals
from synth.analysis.sampled_norm import sampled_norm
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller
from synth.controller.open_loop import sampled
from synth.controller.problem import generalized_plant, measurements
from synth.plant.augmented import on_larger_plant
from synth.plant.generalized import GeneralizedPlant


def norm_as_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm:
    """Returns the L2 gain of the loop from all disturbances to z, infinite if the loop is not stable.

    Args:
        vehicle: with the controller's implementation.
        timestep: of the runs [s]; the sample period if the vehicle gives none.
    """
    ideal = controller.certificate.norm.value
    near = ideal if 0 < ideal < np.inf else 1.0
    return sampled_norm(sampled_loop(vehicle, controller, timestep), near)


def sampled_loop(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledLoop:
    """Returns the loop as implemented, with the plant's weights and lag; arguments as for `norm_as_implemented`."""
    how = vehicle.implementation
    period = how.sample_period or timestep
    cut = sampled(vehicle, controller, period)
    plant = plant_as_built(vehicle)
    n, kept = len(plant.A), len(cut.kept)
    own = len(cut.model.A) - kept
    G = np.insert(cut.G, [own] * (n - own), 0.0, axis=1)  # of states of filters nobody measures any
    memory = np.hstack([np.zeros((kept, n)), np.eye(kept)]) + period * G[cut.forces :]
    noise = None
    if any(controller.hardware.noise):
        rms = np.array(controller.hardware.noise)
        heard = cut.reading @ np.diag(rms)[:, rms > 0] / math.sqrt(period)  # as in `SampledDataProblem`
        noise = np.vstack([heard[: cut.forces], period * heard[cut.forces :]])
    return SampledLoop(plant, hold_intervals(period, how.delay), G[: cut.forces], memory, period * cut.hold, noise)


def held_problem(vehicle: Vehicle, entry: ControllerEntry) -> SampledDataProblem:
    """Returns the sampled-data problem of a controller: the vehicle with its filters, its actuators' lag, and the measurements.

    Raises:
        InputError: the vehicle has no sample period.
    """
    how = vehicle.implementation
    if how.sample_period is None:
        raise InputError(
            f"controller {entry.name!r} is designed for the loop that a computer closes, and [implementation] gives no sample "
            "period; give it, as in sample_period = 0.01, seconds"
        )
    Cy, through = measurements(vehicle, entry.measured, vehicle.limits.actuator_bandwidth)
    rms = np.array(entry.hardware.noise) if any(entry.hardware.noise) else None
    return SampledDataProblem(plant_as_built(vehicle), Cy, through, hold_intervals(how.sample_period, how.delay), rms)


def false_sampled_bound(vehicle: Vehicle, entry: ControllerEntry) -> tuple[str, ...]:
    """Returns the false claim of a record about the lower bound of the sampled loop, in words; empty without one.

    The dual solution is checked on the discrete plant of the claimed level, which is computed anew.

    Raises:
        InputError: the proof is malformed.
    """
    record = entry.certificate or {}
    if SAMPLED_BOUND not in record:
        return ()
    claimed = f"the lower bound of the sampled loop is claimed to be {record[SAMPLED_BOUND]:.10g}"
    if vehicle.implementation.sample_period is None:
        return (f"{claimed}, and [implementation] has no sample_period",)
    bound = read_sampled_bound(record, held_problem(vehicle, entry))
    return () if bound.holds else (f"{claimed}, and its proof does not hold with this vehicle",)


def norm_in_continuous_time(vehicle: Vehicle, controller: Controller) -> float:
    """Returns the limit of the norm for fast sampling: that of the loop with its actuators' lag, and the road alone."""
    if controller.hardware == NOMINAL and vehicle.limits.actuator_bandwidth is None:
        return controller.certificate.norm.value
    Cy, through = measurements(vehicle, controller.measured, vehicle.limits.actuator_bandwidth)
    plant, G = on_larger_plant(plant_as_built(vehicle), Cy, controller.law.continuous().fed_back(through))
    return hinf_norm(plant.closed_loop(G)).value


def plant_as_built(vehicle: Vehicle) -> GeneralizedPlant:
    """Returns the plant (15) behind its actuators' lag, if they have one; z weights the acting forces."""
    return generalized_plant(vehicle, vehicle.limits.actuator_bandwidth, acting=True)
