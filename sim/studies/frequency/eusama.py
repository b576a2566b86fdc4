"""EUSAMA test: the smallest tyre load, relative to the static load, on a plate that moves by 6 mm at up to 25 Hz.

Workshops use the EUSAMA test of the European Shock Absorber Manufacturers Association (TS-02-76, 1976). In the test, a plate
under one wheel at a time moves up and down by 6 mm from peak to peak. The frequency of the plate begins at 25 Hz and decreases.
The result of the test is the smallest tyre load relative to the static load. Let t be the tyre deflection, t_0 the static tyre
deflection, and z_r the height of the plate. In a linear vehicle, the ratio of smallest to static tyre load follows from the
frequency response t / z_r:

    ratio = 1 - 3 mm  max |t / z_r| / t_0,    and 0 if this is negative, because the wheel lifts off.

MuJoCo simulates the plate under each wheel at the worst frequency. The validity of the test is disputed, because cars with
intact dampers fail if they have stiff tyres and light axles: M. Klapka, I. Mazurek and O. Machacek (2016), "Analysis of causes
of false-negative evaluation of EUSAMA methodology for suspension assessment", Engineering Mechanics 2016, Svratka.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.document.field import Field, Record
from models.kinds.kind import Parameters, Wheel
from models.roads.road import Road
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import LIFT_OFF, ended_by
from sim.linear.frequency_response import sampled_frequency_response
from sim.linear.sampled_response import taylor4
from sim.runs.agreement import COARSEST, SLACK
from sim.studies.frequency.identification import ideal_measurements
from sim.studies.frequency.sinusoids import ALIASING_LIMIT, HIGHEST, PeriodicRoad, PeriodicRun, drive_periodic, whole_periods
from synth.controller.controller import Controller

STROKE = 3e-3  # m, amplitude with which the test plate moves
# lowest frequency to evaluate [Hz], below which the wheel follows the test plate; number of frequencies to evaluate
LOWEST, GRID = 0.3, 600
WINDOW = 4.0  # s, approximate duration of the evaluated end of a run, to which sinusoids are fitted
# Largest relative effect of the body's rotation on a tyre deflection; a height of 3 mm under one wheel of a car causes only
# 1e-5
TURNING_SHARE = 1e-3
DISPUTED_LIMIT = "disputed: stiff tyres under light axles fail with sound dampers (Klapka, Mazurek, Machacek 2016)"


@dataclass(frozen=True)
class MinimumLoad:
    """Smallest load of one tyre on the plate, relative to its static load, predicted and measured in MuJoCo.

    Attributes:
        tyre: name of the tyre deflection signal.
        ratio: predicted minimum of the load ratio over all frequencies for the implemented (sampled-data) loop; never below 0.
        omega: frequency of the plate at the predicted minimum [rad/s].
        driven: predicted minimum of the load ratio at the frequency of the MuJoCo run, which is near `omega`; may be negative.
        measured: minimum of the load ratio in the MuJoCo run.
        allowed: allowed difference between `driven` and `measured`. `allowed` is infinite for a vehicle with nonlinear springs
            or dampers, because the prediction uses a linearisation.
        ended: names of the limits that ended the linear regime in the run.
    """

    tyre: str
    ratio: float
    omega: float
    driven: float
    measured: float
    allowed: float
    ended: tuple[str, ...]

    @property
    def end(self) -> str:
        """Names of the limits that ended the linear regime; if no limit did, `curve` if the prediction uses a linearisation,
        otherwise empty.
        """
        return ", ".join(self.ended) or ("curve" if math.isinf(self.allowed) else "")


SHARE_OF_LOAD = Field[float]("share of the load", lambda one: one, ".5f")


def minimum_loads(vehicle: Vehicle, controllers: Sequence[Controller], timestep: float) -> list[tuple[MinimumLoad, ...]]:
    """Predicts the minimum load of each wheel, and measures this load in MuJoCo.

    Args:
        vehicle: vehicle that the controllers control.
        controllers: controllers with stable loops.
        timestep: timestep of the simulation [s].

    Returns:
        For each controller, the minimum loads of all wheels, predicted and measured.
    """
    vehicle, wheels = ideal_measurements(vehicle), vehicle.kind.wheels
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)
    highest = min(HIGHEST, ALIASING_LIMIT / (2 * steps_per_sample(vehicle.implementation, timestep) * timestep))
    pairs = [(controller, i) for controller in controllers for i in range(len(wheels))]
    worst = [_worst(vehicle, *pair, highest, timestep) for pair in pairs]
    plates = [_plate(wheels[i].road_velocity, omega, timestep) for (_, i), omega in zip(pairs, worst, strict=True)]
    runs = drive_periodic(vehicle, [controller for controller, _ in pairs], plates, timestep)
    loads = [_load(run, i, omega, static) for (_, i), omega, run in zip(pairs, worst, runs, strict=True)]
    return [tuple(loads[first : first + len(wheels)]) for first in range(0, len(loads), len(wheels))]


@dataclass(frozen=True)
class Plate(Road):
    """Road that is a sinusoidally moving plate under one wheel. The vehicle does not drive, and the ground under the other
    wheels is at rest.

    Attributes:
        wheel: name of the road signal under the moved wheel.
        omega: frequency of the plate [rad/s].
        stroke: amplitude of the plate's motion [m].
    """

    wheel: str
    omega: float
    stroke: float = STROKE

    speed = 0.0
    laid = False

    def track_of(self, wheel: Wheel) -> str:
        """Returns the name of the road signal under a wheel."""
        return wheel.road_velocity

    def delay_of(self, wheel: Wheel, parameters: Parameters) -> float:
        """Returns a delay of 0, because the vehicle does not drive."""
        return 0.0

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times at which the plate's velocity jumps [s]: only the start of the run."""
        return (0.0,)

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height of the ground under a wheel [m]. `side` names the road signal under this wheel."""
        return np.where((t >= 0) & (side == self.wheel), self.stroke * np.sin(self.omega * t), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of the height of the ground under a wheel [m/s]. `side` names the road signal under the
        wheel.
        """
        return np.where((t >= 0) & (side == self.wheel), self.stroke * self.omega * np.cos(self.omega * t), 0.0)

    def describe(self) -> dict[str, Any]:
        """Returns the type, wheel, frequency and amplitude of the plate for the JSON output."""
        return {"type": "plate", "wheel": self.wheel, "omega": self.omega, "stroke": self.stroke}

    def scaled(self, factor: float) -> "Plate":
        """Returns a plate whose amplitude is multiplied by a factor."""
        return replace(self, stroke=factor * self.stroke)


def _plate(wheel: str, omega: float, timestep: float) -> PeriodicRoad:
    """Returns a plate whose frequency is near `omega` [rad/s], so that the evaluated samples contain an integer number of
    periods.
    """
    _, samples = whole_periods(omega, timestep)
    samples *= max(1, round(WINDOW / (samples * timestep)))
    tried = round(samples * timestep * omega / (2 * np.pi)) * 2 * np.pi / (samples * timestep)
    return PeriodicRoad(Plate(wheel, tried), np.array([tried]), samples)


def _amplitude(vehicle: Vehicle, controller: Controller, wheel: int, omega: Array, timestep: float, exponential: Any) -> Array:
    """Returns the amplitude of a tyre deflection relative to the amplitude of the plate under the same wheel, for each
    frequency.

    For a tyre with damping, the deflection is replaced by the deflection at which the tyre stiffness alone would cause the
    total force.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        wheel: index of the wheel on the plate.
        omega: frequencies of the plate [rad/s], shape (F,).
        timestep: timestep of the simulation [s].
        exponential: function that computes the matrix exponential, either exactly or as RK4 approximates it.
    """
    response = sampled_frequency_response(vehicle, controller, omega, timestep, exponential)
    outputs = vehicle.linear_model.outputs
    name = vehicle.kind.wheels[wheel].tyre_deflection
    deflection = response[:, outputs.index(name), wheel]
    if (tyre := vehicle.kind.damped_tyres(vehicle.parameters).get(name)) is not None:
        deflection = deflection + tyre.time * (response[:, outputs.index(tyre.hub), wheel] - 1)
    return omega * np.abs(deflection)


def _worst(vehicle: Vehicle, controller: Controller, wheel: int, highest: float, timestep: float) -> float:
    """Returns the frequency [rad/s] up to `highest` [Hz] at which the amplitude of a tyre deflection is largest."""
    from scipy import optimize  # imported here because the import takes half a second

    omega = 2 * np.pi * np.geomspace(LOWEST, highest, GRID)
    at = int(np.argmax(_amplitude(vehicle, controller, wheel, omega, timestep, linalg.expm)))
    around = omega[max(at - 1, 0)], omega[min(at + 1, GRID - 1)]
    peak: Any = optimize.minimize_scalar(
        lambda w: -_amplitude(vehicle, controller, wheel, np.array([w]), timestep, linalg.expm)[0],
        bounds=around,
        method="bounded",
        options={"xatol": 1e-9 * around[1]},
    )
    return float(peak.x)


def _load(run: PeriodicRun, wheel: int, omega: float, static: Mapping[str, float]) -> MinimumLoad:
    """Returns the minimum load of a wheel, measured at the end of its MuJoCo run.

    Args:
        run: MuJoCo run with the plate at a frequency near `omega`.
        wheel: index of the wheel on the plate.
        omega: frequency at which the minimum load is predicted [rad/s].
        static: deflection of each tyre under the static load [m], by tyre.
    """
    vehicle, controller, tried, timestep = run.vehicle, run.controller, run.on.omega, run.timestep
    assert controller.linear is True, "minimum loads are those of linear laws"
    tyre = vehicle.kind.wheels[wheel].tyre_deflection
    share = STROKE / static[tyre]
    exact, integrated = (
        float(_amplitude(vehicle, controller, wheel, tried, timestep, exponential)[0]) for exponential in (linalg.expm, taylor4)
    )
    ended = ended_by(vehicle, run.response, controller.has_anti_windup)
    bends = bool(vehicle.parts.with_curve) or vehicle.parts.nonlinear
    if ended or bends:
        (limit,) = (one for one in LIFT_OFF.thresholds(vehicle) if one.signal == tyre)
        measured = max(0.0, 1 - float(limit.of(run.response)[-run.on.samples :].max()) / static[tyre])
    else:
        lines = run.lines(with_images=True)
        carried = lines[tyre][0]
        if (damped := vehicle.kind.damped_tyres(vehicle.parameters).get(tyre)) is not None:
            carried = carried + damped.time * (lines[damped.hub][0] - lines[damped.road][0])
        measured = 1 - float(np.abs(carried)) / static[tyre]
    allowed = math.inf if bends else share * exact * (min(SLACK * abs(integrated / exact - 1), COARSEST) + TURNING_SHARE)
    peak = float(_amplitude(vehicle, controller, wheel, np.array([omega]), timestep, linalg.expm)[0])
    return MinimumLoad(tyre, max(0.0, 1 - share * peak), omega, 1 - share * exact, measured, allowed, tuple(ended))


def load_failures(loads: Sequence[MinimumLoad]) -> list[str]:
    """Returns a text for each minimum load that differs from its prediction by more than allowed."""
    return [
        f"in EUSAMA's test, {one.tyre} keeps {SHARE_OF_LOAD.text(one.measured)} of its static load; "
        f"{SHARE_OF_LOAD.text(one.driven)} is predicted"
        for one in loads
        if not one.ended and not abs(one.measured - one.driven) <= one.allowed
    ]


TYRE = Record[MinimumLoad](
    "ratio",
    "omega",
    "driven",
    mujoco="measured",
    allowed="allowed",
    ended="ended",
)
RECORD = Record[Sequence[MinimumLoad]](
    disputed=lambda loads: DISPUTED_LIMIT.removeprefix("disputed: "),
    tyres=TYRE.all(lambda loads: {one.tyre: one for one in loads}),
)
