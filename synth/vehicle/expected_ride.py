"""Expected ride of a loop on a random road: the weighted rms acceleration of the body as in ISO 2631-1.

The H-infinity norm is the worst gain from the road to the output z, with the weights in `[performance]`. A design may reduce
this worst gain (the norm) and still make the ride worse. The expected ride is therefore also computed, from the road spectrum
and the ideal loop. The vertical road velocity is white noise of density G_v within a frequency band. The rear wheels pass over
the same road with a delay, and a coherence function relates the left and right tracks. Let H be the frequency response of an
acceleration to the road under every wheel. Let e be the frequency response of the road to two independent white-noise sources,
and W_k the frequency weighting of ISO 2631-1. Then

    mean square = G_v integral of |W_k H e|^2 df.

The loop is assumed to be continuous and without limits, so the actuators deliver every requested force. `sim.drive` computes
the ride of the sampled-data loop. Straight lines replace the nonlinear characteristics of dampers and springs. The straight
lines follow from statistical linearisation on the random road, because the tangents at equilibrium are valid only for far
smaller motions (`synth/controller/equivalent_line.py`).
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.threads import one_thread
from models.document.text import names_text
from models.laws.filter import WEIGHTINGS, Filter
from models.roads.iso8608 import Iso8608
from models.roads.road import track_width
from models.roads.spectrum import longest_panel, sources
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of, road_inputs
from synth.plant.harmonic_response import frequency_response
from synth.plant.quadrature import sample_band

ROAD_CLASS, SPEED = "C", 20.0  # road class of an average road, and driving speed [m/s]
METHOD = "statistical linearisation"  # default method for vehicles with nonlinear characteristics
WEIGHTING_FILTER = Filter(WEIGHTINGS["iso2631_wk"], "iso2631_wk")


@one_thread()
def expected_ride(vehicle: Vehicle, controller: Controller, points: Sequence[str] | None = None) -> float | None:
    """Returns the expected weighted rms acceleration on an average road, at the worst of several points [m/s2].

    The result is None if the ideal loop is not stable, or if the vehicle has no signal that is a vertical acceleration of the
    body. The result is also None if no equivalent linear vehicle exists.

    Args:
        vehicle: vehicle of the controller.
        controller: linear controller.
        points: names of the acceleration signals at these points. Default: the points where a person sits or, if there is no
            person, all points of the body.
    """
    felt = points or vehicle.ride_points.worst_of
    if not felt or not controller.certificate.stable:
        return None
    if vehicle.parts.nonlinear:
        from synth.controller.equivalent_line import equivalent_line

        line = equivalent_line(vehicle, controller, lambda car, signals: _deviations(car, controller, signals))
        if line is None:
            return None
        vehicle = line.vehicle
    ride = _deviations(vehicle, controller, felt, WEIGHTING_FILTER)
    return None if ride is None else float(ride.max())


def no_line(vehicle: Vehicle, controller: Controller) -> str:
    """Returns a text that explains why no equivalent linear vehicle exists for a stable loop.

    The text is empty if the expected ride is missing for a different reason.
    """
    curved = vehicle.parts.nonlinear and controller.certificate.stable and vehicle.ride_points.worst_of
    from synth.controller.equivalent_line import without_curve

    if curved and (others := without_curve(vehicle)):
        return f"statistical linearisation requires forces that depend on one signal only, unlike {names_text(others)} of [parts]"
    return "statistical linearisation finds no linear approximation with a stable loop" if curved else ""


def _deviations(
    vehicle: Vehicle, controller: Controller, signals: Sequence[str], weighting: Filter | None = None
) -> Array | None:
    """Returns the rms of output signals of a linear vehicle over an average road, shape (k,); None if the loop is unstable."""
    loop, model = loop_of(vehicle, controller), vehicle.linear_model
    poles = np.linalg.eigvals(loop.closed_loop.A)
    if poles.real.max() >= 0:
        return None
    road = Iso8608(ROAD_CLASS, speed=SPEED, track_width=track_width(vehicle)).spectrum

    def spectra(omega: Array) -> Array:
        """Returns the spectra of the signals relative to the spectrum of the road, shape (F, k)."""
        response = frequency_response(loop, signals, road_inputs(model, controller, omega), omega)
        amplitude = response @ sources(vehicle, road, omega)
        if weighting is not None:
            amplitude = weighting.response(omega)[:, None, None] * amplitude
        return np.sum(np.abs(amplitude) ** 2, axis=-1)

    filter_poles = [np.roots(below) for _, below in weighting.sections] if weighting is not None else []
    every = np.concatenate([poles, *filter_poles])
    band = sample_band(spectra, lambda _, value: value, *road.band, every, longest_panel(vehicle, SPEED, controller.ahead))
    return np.sqrt(road.density * (band.share @ band.values))
