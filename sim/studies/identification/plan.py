"""Plans of a rig test, which predict how accurately chirps would determine the parameters.

The covariance of the parameters is predicted from the vehicle, the sensors and the sensor noise (Cramer-Rao bound). Each chirp
has the largest amplitude, with a reserve, at which every wheel stays on its post.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.document.field import Field, Record
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.estimation.structure import standard_deviations
from sim.studies.identification.experiment import Channel, Experiment
from sim.studies.identification.identification import changed, free_parameters
from sim.studies.identification.log_map import LogMap
from sim.studies.identification.prediction import LogPrediction

RESERVE = 0.8  # the motion may use this share of the static tyre compression and of the suspension travel
DURATIONS = (10.0, 30.0, 60.0)  # durations of a test to choose from [s]
BANDS = ((0.5, 5.0), (0.5, 20.0), (2.0, 20.0))  # frequency bands to choose from [Hz]
LARGEST = 0.05  # m, largest amplitude with which a post of the rig moves
TRAVEL = 0.06  # m, assumed suspension travel in each direction
STEP = 0.005  # s, time step of the planned motion
APART = 0.3  # relative difference between the frequencies at which two posts start


@dataclass(frozen=True)
class ChirpPlan:
    """A chirp, and the predicted accuracy of the parameters that would be estimated from this chirp.

    Attributes:
        duration: duration of the chirp [s].
        low, high: frequencies of the chirp at its start and at its end [Hz].
        amplitude: amplitude of the posts' motion [m].
        deviations: predicted relative standard deviation of each parameter; infinite if the chirp does not determine the
            parameter.
    """

    duration: float
    low: float
    high: float
    amplitude: float
    deviations: Mapping[str, float]

    @property
    def worst(self) -> float:
        """The largest relative standard deviation of any parameter in this plan."""
        return max(self.deviations.values())


PLANS = (
    Field[ChirpPlan]("chirp", lambda one: f"{one.low:g} to {one.high:g} Hz", key="chirp"),
    Field[ChirpPlan]("duration", lambda one: one.duration, ".0f", key="duration", unit="s"),
    Field[ChirpPlan]("amplitude", lambda one: one.amplitude, ".2g", 1e3, key="amplitude", unit="mm"),
    Field[ChirpPlan]("worst deviation", lambda one: one.worst, ".2g", 100, key="worst", unit="%"),
)

PLAN = Record[ChirpPlan](*PLANS, deviations="deviations")


def chirp(duration: float, low: float, high: float, step: float) -> Array:
    """Returns a chirp with amplitude 1 whose frequency [Hz] grows exponentially, with a fade-in of one period, shape (T,)."""
    time = np.arange(0, duration + step / 2, step)
    scale = duration / np.log(high / low)
    return np.minimum(time * low, 1.0) * np.sin(2 * np.pi * low * scale * (np.exp(time / scale) - 1))


def plans(vehicle: Vehicle, log_map: LogMap, fix: Sequence[str] = (), free: Sequence[str] = ()) -> list[ChirpPlan]:
    """Returns plans with chirps for all posts, sorted by the largest relative standard deviation of any parameter, smallest
    first.

    The chirps of different posts start at different frequencies, so that all modes of the body are excited.

    Args:
        log_map: map that defines the sensors and their noise.

    Raises:
        InputError: the map does not state the noise of a sensor.
    """
    silent = [name for name, one in log_map.sensors.items() if one.noise is None and not name.startswith("road")]
    sensors = {name: one.noise for name, one in log_map.sensors.items() if one.noise is not None}
    if silent or not sensors:
        raise InputError(
            f"a plan of a test needs the noise of each sensor; give noise below [signals.{list_names(silent) or 'NAME'}]"
        )
    named = replace(vehicle, kind=vehicle.kind.naming({*vehicle.kind.possible}))
    first, wheels = free_parameters(named, fix, free), len(named.kind.wheels)
    each = list[ChirpPlan]()
    for duration in DURATIONS:
        for low, high in BANDS:
            road = np.stack([chirp(duration, low * (1 + APART * i), high, STEP) for i in range(wheels)], axis=-1)
            amplitude = min(LARGEST, RESERVE / _loads(named, road))
            channels = tuple(Channel(name, np.zeros(len(road)), noise) for name, noise in sensors.items())
            forces = np.zeros((len(road), len(named.linear_model.inputs)))
            experiment = Experiment("plan", STEP, amplitude * road, forces, channels, from_rest=True)
            problem = IdentificationProblem(named, changed, first, (experiment,), log_map.known)
            each.append(ChirpPlan(duration, low, high, amplitude, standard_deviations(problem)))
    return sorted(each, key=lambda one: (one.worst, one.duration))


def _loads(vehicle: Vehicle, road: Array) -> float:
    """Returns the larger of two ratios on a road: tyre motion to static compression, and suspension motion to available
    travel.
    """
    limits = {name: abs(one) for name, one in vehicle.kind.static_tyre_deflection(vehicle.parameters).items()}
    limits |= {place.deflection: TRAVEL for place in vehicle.kind.suspensions}
    names = [name for name in limits if name in vehicle.linear_model.outputs]
    forces = np.zeros((len(road), len(vehicle.linear_model.inputs)))
    rig = Experiment("plan", STEP, road, forces, (), from_rest=True)
    values = LogPrediction(rig, lambda _: vehicle).signals(names, {}, None)
    return float(np.abs(values / [limits[name] for name in names]).max())
