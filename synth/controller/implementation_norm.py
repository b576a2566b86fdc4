"""L2 gain of a vehicle's sampled-data loop, from the continuous road velocity to the continuous output z.

This L2 gain corresponds to the norm (18) of the continuous loop, but also takes into account `[implementation]` and the
actuator lag in `[limits]`. The force is delayed and held constant during each sample period, while road and vehicle move
continuously. Nonlinear parts (limits of force and stroke, quantisation) are not included. Measurement noise is included if the
controller's section specifies it. With actuator lag, z contains the lagged force that acts on the vehicle. An integral in z is
not included, because a computer adds up samples instead of integrating, and only the sum of samples returns to zero.
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
from synth.controller.measured_heights import road_rates
from synth.controller.problem import generalized_plant, measurements, problem
from synth.plant.generalized import Plant

# decay per period of the integral from which the mean road velocity is computed. Without this decay, the loop would not be
# stable
FORGOTTEN = 1e-5


def norm_as_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm:
    """Returns the L2 gain of the sampled-data loop from all disturbances to z. The gain is infinite if the loop is not stable.

    Args:
        vehicle: vehicle with the implementation of the controller.
        controller: linear controller of this vehicle.
        timestep: timestep of the simulations [s], used as the sample period if the vehicle file does not specify one.
    """
    ideal = controller.certificate.norm.value
    near = ideal if 0 < ideal < np.inf else 1.0
    return sampled_norm(sampled_loop(vehicle, controller, timestep), near)


def sampled_loop(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledLoop:
    """Returns the sampled-data loop of a vehicle and a controller, with weights and actuator lag.

    With tyre damping, a measurement may contain the road velocity. In this case, the mean road velocity over the last sample
    period is used instead. If only the energy of the road velocity is limited, the velocity at a single instant is not limited.
    The mean velocity agrees with MuJoCo, where the road moves in steps. The road height in a measurement is the integral of the
    road velocity. For the arguments, see `norm_as_implemented`.
    """
    period, model = vehicle.implementation.sample_period or timestep, vehicle.linear_model
    problem = _sampled_problem(vehicle, controller.measured, period, controller.hardware.noise)
    with error_in(f"controller {controller.name!r}:"):
        law = controller.law.sampled(period).matrix
    rows = [model.outputs.index(name) for name in controller.measured]
    if not model.Dw[rows].any() and not model.Cr[rows].any():
        return problem.loop(law)
    # The plant integrates the velocity, with a decay of `FORGOTTEN` per period. The law stores the value of the integral at the
    # last sample. The difference between the present and the stored value gives the mean velocity.
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
    """Returns the sampled-data problem for measured signals; if noise is given, the problem contains the rms noise of each
    measurement.
    """
    Cy, through = measurements(vehicle.without_integrals, measured, vehicle.limits.actuator_bandwidth)
    rms = np.array(noise) if any(noise) else None
    plant = replace(plant_as_built(vehicle), Cy=Cy, Dyu=through)
    return SampledDataProblem(plant, hold_intervals(period, vehicle.implementation.delay), rms)


def held_problem(vehicle: Vehicle, entry: ControllerEntry) -> SampledDataProblem:
    """Returns the sampled-data problem of a controller: the vehicle with filters, actuator lag and measurements.

    Raises:
        InputError: the vehicle has no sample period, or a measurement contains the road velocity.
    """
    how, model = vehicle.implementation, vehicle.linear_model
    if how.sample_period is None:
        raise InputError(
            f"controller {entry.name!r} is designed for the sampled-data loop, but [implementation] has no sample "
            "period; give sample_period in seconds, such as sample_period = 0.01"
        )
    if pushed := [name for name in entry.measured if np.any(model.Dw[model.outputs.index(name)])]:
        raise InputError(
            f"controller {entry.name!r} cannot be designed for the sampled-data loop: {pushed[0]!r} contains the "
            "road's velocity because of tyre_damping, so the samples of this signal have no bound; omit the signal "
            "or tyre_damping"
        )
    return _sampled_problem(vehicle, entry.measured, how.sample_period, entry.hardware.noise)


def false_sampled_bound(vehicle: Vehicle, entry: ControllerEntry) -> tuple[str, ...]:
    """Checks the claimed lower bound of the sampled-data loop.

    Returns a text that describes the claim if the claim is false, otherwise an empty tuple.

    The discrete plant that belongs to the claimed bound is computed again, and the dual solution is checked for this plant.

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
    """Returns the limit that the norm of the sampled-data loop approaches as the sample period goes to zero.

    The limit is the norm of the continuous loop with actuator lag. The road is the only disturbance of the continuous loop.
    """
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
    """Returns the plant (15), with actuator lag if the vehicle file specifies a lag.

    With lag, the output z contains the forces after the lag.
    """
    return generalized_plant(vehicle.without_integrals, vehicle.limits.actuator_bandwidth, acting=True)
