"""A controller of a vehicle file with the smallest mean square, from Riccati equations: LQR, LQG, H2, or preview LQ."""

import numpy as np

from models.common.errors import InputError
from models.common.printed import digits
from models.laws.preview import RoadPreview
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller, on_readings
from synth.controller.problem import Problem, plant_states, road_twist_inputs
from synth.design.full_order.preview import preview_design
from synth.design.full_order.quadratic import AT_ONCE, state_rows
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
            "LQG uses white noise of intensity rms times sqrt(sample_period), but [implementation] has noise without "
            "sample_period; give both, or neither"
        )
    rms = [how.noise.get(name, 0.0) for name in entry.measured] + [0.0] * len(posed.measured_integrals)
    levels = [rms[i] * (how.sample_period or 0.0) ** 0.5 for i in posed.state_measurements]
    return levels if any(levels) else None


def preview_controller(vehicle: Vehicle, entry: ControllerEntry, posed: Problem) -> Controller:
    """Returns the controller of a preview LQ design, with its feedback on sensor readings and its preview on roads.

    A twist of the road, which acts by its height, is a disturbance beside its velocity (`generalized_plant`), and known too.

    Raises:
        InputError: the states of filters in [performance] are not measured; or as `preview_design`.
        DesignError: errors of `preview_design`.
    """
    plant = posed.of_states
    try:
        state_rows(plant)
    except DesignError:
        raise InputError(
            f"controller {entry.name!r}: a preview needs a measured state, and no sensor measures the states of filters in "
            "[performance]; give constant weights, integrals of deflections, or another design"
        ) from None
    design = preview_design(plant, entry.preview, plant_states(vehicle, entry.hardware.bandwidth), plant.Cy)
    law, ahead, model = on_readings(design.law, posed), design.preview, vehicle.linear_model
    if ahead is not None:
        r = len(model.disturbances)
        heights = ahead.B[:, r:] @ (model.twist_rate * road_twist_inputs(model))
        ahead = RoadPreview(ahead.seconds, ahead.A, ahead.B[:, :r], heights, ahead.C)
    best = (
        f"minimises the mean square of z with the road {entry.preview:g} s ahead: the H2 norm is {digits(design.h2_norm)} "
        f"({digits(design.without)} without preview), the rms of z if road velocity is white noise of intensity "
        f"1{AT_ONCE if np.any(posed.plant.Dw) else ''}"
    )
    return Controller.of(entry, law, design.certificate, remarks=(best,), preview=ahead)
