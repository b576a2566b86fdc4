"""Design problems and results of LQR, LQG, H2 and preview designs of a vehicle, which minimise the mean square of z."""

import numpy as np

from models.common.errors import InputError
from models.common.printed import digits
from models.laws.design_methods import PREVIEW
from models.laws.preview import RoadPreview
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.controller.problem import Problem, road_twist_inputs
from synth.design.full_order.quadratic import AT_ONCE, state_rows
from synth.design.problem import DesignProblem, DesignResult
from synth.plant.numerics import DesignError


def check_preview(entry: ControllerEntry, problem: DesignProblem) -> None:
    """Raises an InputError if the controller of a preview design does not measure every state."""
    try:
        state_rows(problem.plant)
    except DesignError:
        raise InputError(
            f"controller {entry.name!r}: a design with preview must measure all states, but no sensor measures the states "
            "of filters in [performance]; give constant weights, integrals of deflections, or a different design"
        ) from None


def white_noise(vehicle: Vehicle, entry: ControllerEntry, problem: Problem) -> list[float] | None:
    """Returns, for an LQG design, the white-noise intensity of each measurement that depends on the state; None if there is no
    noise.

    Noise of rms sigma in samples that are T seconds apart corresponds to white noise of intensity sigma sqrt(T).

    Raises:
        DesignError: the measurements have noise, but no sample period T is defined.
    """
    how = vehicle.implementation
    if how.sample_period is None and any(how.noise.get(name) for name in entry.measured):
        raise DesignError(
            "LQG uses white noise of intensity rms times sqrt(sample_period), but [implementation] has noise without "
            "sample_period; give both, or neither"
        )
    rms = [how.noise.get(name, 0.0) for name in entry.measured] + [0.0] * len(problem.measured_integrals)
    levels = [rms[i] * (how.sample_period or 0.0) ** 0.5 for i in problem.state_measurements]
    return levels if any(levels) else None


def mean_square_text(problem: DesignProblem, result: DesignResult) -> str:
    """Describes, as text, the H2 norm that a design minimises."""

    at_once = AT_ONCE if np.any(problem.plant.Dw) else ""
    of_white_noise = "the rms of z if road velocity is white noise of intensity 1"
    if problem.design == PREVIEW:
        return (
            f"minimises the mean square of z with the road {problem.preview:g} s ahead: the H2 norm is {digits(result.h2_norm)} "
            f"({digits(result.without)} without preview), {of_white_noise}{at_once}"
        )
    if problem.design == "lqg":  # LQG also assumes a white noise, which is not part of w
        noise = ", with noise of the sensors" if problem.noise is not None and np.any(problem.noise) else ""
    else:
        noise = ", with noise of w on the sensors" if np.any(problem.plant.Dyw) else ""
    return f"minimises the mean square of z: the H2 norm is {digits(result.h2_norm)}, {of_white_noise}{noise}{at_once}"


def preview_of_roads(vehicle: Vehicle, ahead: RoadPreview) -> RoadPreview:
    """Converts a preview of the plant's disturbances to a preview of the road under each wheel.

    In addition to the road velocities, the road's warp is a disturbance of the plant (`generalized_plant`); the warp is also
    known in advance.
    """

    model = vehicle.linear_model
    r = len(model.disturbances)
    heights = ahead.B[:, r:] @ (model.twist_rate * road_twist_inputs(model))
    return RoadPreview(ahead.seconds, ahead.A, ahead.B[:, :r], heights, ahead.C)
