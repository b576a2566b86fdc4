"""A controller of a vehicle file that is the best in the mean, from Riccati equations: LQR, LQG, H2, or preview LQ."""

from dataclasses import replace

import numpy as np

from models.common.errors import InputError
from models.laws.linear import LinearLaw
from models.laws.preview import RoadPreview
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller, on_readings
from synth.controller.problem import Problem, plant_states, problem, road_twist_inputs
from synth.design.full_order.preview import PreviewDesign, preview_design
from synth.design.full_order.quadratic import (
    AT_ONCE,
    QuadraticDesign,
    h2_norm,
    quadratic_design,
    state_rows,
    with_extra_disturbances,
)
from synth.plant.numerics import DesignError


def white_noise(vehicle: Vehicle, entry: ControllerEntry, posed: Problem) -> list[float] | None:
    """Returns the noise of each measurement that depends on the state, for LQG; None without noise.

    Drawn every T seconds, noise of rms sigma is white noise of sigma sqrt(T).

    Raises:
        DesignError: noise is given, and no T.
    """
    how = vehicle.implementation
    if entry.design == "lqg" and how.sample_period is None and any(how.noise.get(name) for name in entry.measured):
        raise DesignError(
            "LQG takes noise as white noise of rms times root of sample_period, and [implementation] gives noise without "
            "sample_period; give both, or neither"
        )
    rms = [how.noise.get(name, 0.0) for name in entry.measured] + [0.0] * len(posed.measured_integrals)
    levels = [rms[i] * (how.sample_period or 0.0) ** 0.5 for i in posed.state_measurements]
    return levels if any(levels) else None


def quadratic_optimum(vehicle: Vehicle, entry: ControllerEntry) -> QuadraticDesign:
    """Returns the quadratic design of a section, with its law on sensor readings.

    Args:
        vehicle: its weights, and the noise of its sensors.
        entry: its `design` is "lqr", "lqg" or "h2".

    Raises:
        InputError, DesignError: as `quadratic_design` and `on_readings`.
    """
    posed = problem(vehicle, entry.measured, entry.hardware)
    Cy, Dyw = posed.select_rows(posed.state_measurements)
    states, noise = plant_states(vehicle, entry.hardware.bandwidth), white_noise(vehicle, entry, posed)
    optimum = quadratic_design(entry.design, posed.plant, Cy, states, noise, Dyw)
    return replace(optimum, law=on_readings(optimum.law, posed))


def preview_optimum(vehicle: Vehicle, entry: ControllerEntry, posed: Problem) -> PreviewDesign:
    """Returns the preview LQ design of a section, with its feedback on sensor readings and its preview on roads.

    A twist of the road, which acts by its height, is a disturbance beside its velocity (`generalized_plant`), and known too.

    Args:
        entry: its `design` is "preview".

    Raises:
        InputError: the states of filters in [performance] are not measured; or as `preview_design`.
        DesignError: as `preview_design`.
    """
    Cy, _ = posed.select_rows(posed.state_measurements)
    try:
        state_rows(posed.plant, Cy)
    except DesignError:
        raise InputError(
            f"controller {entry.name!r}: a preview is of the measured state, and no sensor reads the states of filters in "
            "[performance]; give constant weights, integrals of deflections, or another design"
        ) from None
    found = preview_design(posed.plant, entry.preview, plant_states(vehicle, entry.hardware.bandwidth), Cy)
    law, ahead, model = on_readings(found.law, posed), found.preview, vehicle.linear_model
    if ahead is None:
        return replace(found, law=law)
    r = len(model.disturbances)
    heights = ahead.B[:, r:] @ (model.twist_rate * road_twist_inputs(model))
    return replace(found, law=law, preview=RoadPreview(ahead.seconds, ahead.A, ahead.B[:, :r], heights, ahead.C))


def preview_controller(vehicle: Vehicle, entry: ControllerEntry, posed: Problem) -> Controller:
    """Returns the controller of a preview LQ design.

    Raises:
        InputError, DesignError: as `preview_design`.
    """
    found = preview_optimum(vehicle, entry, posed)
    best = (
        f"the best in the mean with the road {entry.preview:g} s ahead: H2 norm {found.h2_norm:.7g}, and {found.without:.7g} "
        f"without, the rms of z where road velocity is white noise of intensity one{AT_ONCE if np.any(posed.plant.Dw) else ''}"
    )
    made = Controller(entry.name, entry.measured, found.law, True, found.certificate, remarks=(best,), hardware=entry.hardware)
    return replace(made, preview=found.preview)


def h2_norm_of(vehicle: Vehicle, entry: ControllerEntry, law: LinearLaw) -> float:
    """Returns the H2 norm that `quadratic_optimum` minimises, for any law on the measurements with a stable loop.

    Raises:
        InputError: its loop has no solution.
    """
    posed = problem(vehicle, entry.measured, entry.hardware)
    noise = white_noise(vehicle, entry, posed)
    if entry.design == "lqg" and noise is not None:
        q, r = len(posed.Cy), posed.plant.Bw.shape[1]
        Dyw = np.zeros((q, r + len(noise)))
        Dyw[posed.state_measurements, r:] = np.diag(noise)
        posed = replace(posed, plant=with_extra_disturbances(posed.plant, r + len(noise)), Dyw=Dyw)
    plant, G = posed.closed_loop(law)
    return h2_norm(plant.closed_loop(G))
