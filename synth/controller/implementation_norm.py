"""The L2 gain of a vehicle's sampled loop, from the road's continuous velocity to the continuous z.

It is the continuous norm (18) of the loop with `[implementation]` and the lag of `[limits]`: the force is held and delayed, while
road and vehicle move continuously. Nonlinear parts (limits of force and stroke, quantisation) do not count. Noise of the readings
counts if the controller asks for it. Behind a lag, z weights the acting force. An integral in z does not count: a computer sums
its readings, and only that sum returns to zero.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from models import USUAL_TIMESTEP
from models.common.errors import InputError, error_in
from models.common.printed import exactly
from models.vehicle.controllers import NOMINAL, ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.record import SAMPLED_BOUND, read_sampled_bound
from synth.analysis.sampled_loop import SampledDataProblem, SampledLoop, hold_intervals
from synth.analysis.sampled_norm import sampled_norm
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller
from synth.controller.problem import generalized_plant, measurements, problem, road_rates
from synth.plant.generalized import Plant

FORGOTTEN = 1e-5  # per period, of what the mean of the road's velocity is from: without, its integral would not decay


def norm_as_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm:
    """Returns the L2 gain of the loop from all disturbances to z, infinite if the loop is not stable.

    Args:
        vehicle: vehicle with the controller's implementation.
        timestep: step of the runs [s]; the sample period if the vehicle gives none.
    """
    ideal = controller.certificate.norm.value
    near = ideal if 0 < ideal < np.inf else 1.0
    return sampled_norm(sampled_loop(vehicle, controller, timestep), near)


def sampled_loop(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledLoop:
    """Returns the loop as implemented, with the plant's weights and lag; arguments as for `norm_as_implemented`.

    A reading that contains the road's velocity, by tyres that damp, contains its mean over the last period: no energy of the road
    bounds the velocity at an instant. As in MuJoCo, where a road that is held moves by steps. The road's height in a reading is
    the integral of its velocity.
    """
    period, model = vehicle.implementation.sample_period or timestep, vehicle.linear_model
    problem = _sampled_problem(vehicle, controller.measured, period, controller.hardware.noise)
    with error_in(f"controller {controller.name!r}:"):
        law = controller.law.sampled(period).matrix
    rows = [model.outputs.index(name) for name in controller.measured]
    if not model.Dw[rows].any() and not model.Cr[rows].any():
        return problem.loop(law)
    # The plant integrates the velocity, with a decay of `FORGOTTEN` a period, and the law keeps the integral of the last sample:
    # their difference is the mean.
    (n, m), q, r, plant = problem.plant.B.shape, len(rows), model.Dw.shape[1], problem.plant
    C, D = (rate[:r] for rate in road_rates(vehicle.without_integrals, plant))
    wide = replace(
        plant,
        A=np.block([[plant.A, np.zeros((n, r))], [C, -FORGOTTEN / period * np.eye(r)]]),
        B=np.vstack([plant.B, np.zeros((r, m))]),
        Bw=np.vstack([plant.Bw, D]),
        C=np.hstack([plant.C, np.zeros((len(plant.C), r))]),
        Cy=linalg.block_diag(plant.Cy, np.eye(r)),
        Dyu=np.vstack([plant.Dyu, np.zeros((r, m))]),
        Dyw=np.vstack([plant.Dyw, np.zeros((r, plant.Bw.shape[1]))]),
    )
    now, before = model.Dw[rows] / period + model.Cr[rows], -math.exp(-FORGOTTEN) * model.Dw[rows] / period
    read, states = law[:, :q], law[:, q:]
    kept = np.eye(r, q + r + states.shape[1] + r, q)
    larger = np.vstack([np.hstack([read, read @ now, states, read @ before]), kept])
    noise = np.vstack([problem.noise, np.zeros((r, problem.noise.shape[1]))])
    return SampledLoop.of_law(wide, larger, problem.pieces, noise)


def _sampled_problem(vehicle: Vehicle, measured: Sequence[str], period: float, noise: Sequence[float]) -> SampledDataProblem:
    """Returns the sampled-data problem of measured signals, with the rms noise of each, if there is one."""
    Cy, through = measurements(vehicle.without_integrals, measured, vehicle.limits.actuator_bandwidth)
    rms = np.array(noise) if any(noise) else None
    plant = replace(plant_as_built(vehicle), Cy=Cy, Dyu=through)
    return SampledDataProblem(plant, hold_intervals(period, vehicle.implementation.delay), rms)


def held_problem(vehicle: Vehicle, entry: ControllerEntry) -> SampledDataProblem:
    """Returns the sampled-data problem of a controller: the vehicle with its filters, its actuators' lag, and the measurements.

    Raises:
        InputError: the vehicle has no sample period, or a measurement contains the road's velocity.
    """
    how, model = vehicle.implementation, vehicle.linear_model
    if how.sample_period is None:
        raise InputError(
            f"controller {entry.name!r} is designed for the sampled-data loop, but [implementation] has no sample period; give "
            "it in seconds, such as sample_period = 0.01"
        )
    if pushed := [name for name in entry.measured if np.any(model.Dw[model.outputs.index(name)])]:
        raise InputError(
            f"controller {entry.name!r} cannot be designed for the sampled-data loop: {pushed[0]!r} contains the road's "
            "velocity because of tyre_damping, so its samples have no bound; omit the signal or tyre_damping"
        )
    return _sampled_problem(vehicle, entry.measured, how.sample_period, entry.hardware.noise)


def false_sampled_bound(vehicle: Vehicle, entry: ControllerEntry) -> tuple[str, ...]:
    """Returns the false claim of a record about the lower bound of the sampled loop, in words; empty without one.

    The dual solution is checked on the discrete plant of the claimed level, which is computed again.

    Raises:
        InputError: the proof is malformed.
    """
    record = entry.certificate or {}
    if SAMPLED_BOUND not in record:
        return ()
    claimed = f"the certificate claims that the lower bound of the sampled loop is {exactly(record[SAMPLED_BOUND])}"
    if vehicle.implementation.sample_period is None:
        return (f"{claimed}, but [implementation] has no sample_period",)
    bound = read_sampled_bound(record, held_problem(vehicle, entry))
    return () if bound.holds else (f"{claimed}, but its proof does not hold for this vehicle",)


def norm_in_continuous_time(vehicle: Vehicle, controller: Controller) -> float:
    """Returns the limit of the norm for fast sampling: that of the loop with its actuators' lag, and the road alone."""
    if controller.hardware == NOMINAL and vehicle.limits.actuator_bandwidth is None and not vehicle.integrals:
        return controller.certificate.norm.value
    if vehicle.linear_model.over_datum(controller.measured):
        lagging = replace(NOMINAL, bandwidth=vehicle.limits.actuator_bandwidth)
        return problem(vehicle, controller.measured, lagging).judged(controller.law).certificate().norm.value
    Cy, through = measurements(vehicle.without_integrals, controller.measured, vehicle.limits.actuator_bandwidth)
    plant, model = plant_as_built(vehicle), vehicle.linear_model
    felt = model.Dw[[model.outputs.index(name) for name in controller.measured]]
    Dyw = np.hstack([felt, np.zeros((len(felt), plant.Bw.shape[1] - felt.shape[1]))])
    return hinf_norm(replace(plant, Cy=Cy, Dyu=through, Dyw=Dyw).closed(controller.law.continuous())).value


def plant_as_built(vehicle: Vehicle) -> Plant:
    """Returns the plant (15) behind its actuators' lag, if they have one; z weights the acting forces."""
    return generalized_plant(vehicle.without_integrals, vehicle.limits.actuator_bandwidth, acting=True)
