"""A controller on other vehicles than its own: the largest norm found over a box of parameters, and the physics at its corners.

Which parameters vary, and how far, is the kind's to say, `Parameter.varied`, or asked for. The norm is computed of many vehicles
of the box, and nothing is proved of those between.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy import optimize

from models.common.arrays import Array
from models.common.errors import InputError, error_in, listing, quoted
from models.kinds.kind import Variation, VehicleKind
from models.roads.road import Bump
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.linear.nonlinear_elements import at_rest
from sim.observers.recorder import record
from sim.runs.prediction import Prediction
from sim.runs.run import compare_runs, sample_times
from sim.studies.stability.edge import no_progress
from sim.studies.stability.simulated_loop import Trial, simulated_loop
from sim.studies.stability.step_derivative import step_derivative
from synth.analysis.norm import Gain, by_level_sets, hinf_norm
from synth.controller.controller import Controller

GRID = 49  # norms that are taken first, whatever the box's dimension
MOST = 4  # quantities that vary: physics runs two to that power
HALVINGS = 6  # of the ranges of a vehicle type
EXAMPLE = "as in --vary sprung_mass:0.8:1.2"
DURATION = 0.3  # s, of a run over a bump
BUMP = Bump(height=2e-2, track="left")  # high enough for what geometry makes to be told from rounding


@dataclass(frozen=True)
class ParameterVertex:
    """A vehicle with other parameters than its controller was designed for.

    Attributes:
        factors: factors on the parameters that vary.
        parameters: values of the parameters that change [SI].
        norm: the H-infinity norm; infinite where unstable.
        decays: True if motion in MuJoCo decays, by the derivative of its step.
        agrees: True if MuJoCo agrees with the linear response over a bump.
    """

    factors: tuple[float, ...]
    parameters: dict[str, float]
    norm: float
    decays: bool
    agrees: bool


@dataclass(frozen=True, eq=False)
class Robustness:
    """A controller on a box of other vehicles.

    Attributes:
        varied: the d variations.
        computed: number of vehicles whose norm was computed.
        norm: largest of these H-infinity norms.
        at: parameters that are changed at that norm [SI].
        corners: physics at the corners of the box.
        factors: factors of the first grid of vehicles, evenly over the box, along each of its d axes.
        norms: norms on that grid; infinite for unstable loops.
    """

    varied: tuple[Variation, ...]
    computed: int
    norm: float
    at: dict[str, float]
    corners: tuple[ParameterVertex, ...]
    factors: tuple[Array, ...]
    norms: Array

    @property
    def holds(self) -> bool:
        """Returns True if physics and analysis agree at every corner."""
        return all(corner.agrees and corner.decays == math.isfinite(corner.norm) for corner in self.corners)

    @property
    def text(self) -> str:
        """Describes the box."""
        return ", ".join(map(str, self.varied))


def varied_text(kind: VehicleKind) -> str:
    """Describes the variations of a kind of vehicle."""
    return ", ".join(map(str, kind.variations)) or f"nothing is varied: no parameter of a {kind.name} has a range"


def read_variations(vehicle: Vehicle, texts: Sequence[str]) -> dict[Variation, tuple[str, ...]]:
    """Returns variations from `name:low:high` each, with the parameters that each scales.

    Without any texts these are the variations of the vehicle type, with ranges halved until all corners are vehicles. A name is a
    parameter's, or that of several which differ by their ending, as `tyre_stiffness` of front and rear axle.

    Raises:
        InputError: an unknown name or no range of factors, a parameter that is zero or named twice, or no vehicle at a corner.
    """
    if not texts:
        return _usual(vehicle)
    variations: dict[Variation, tuple[str, ...]] = {}
    for text in texts:
        name, *numbers = text.split(":")
        known = [one for one in vehicle.parameters if vehicle.parameters[one]]
        names = tuple(one for one in known if one == name) or tuple(one for one in known if one.startswith(f"{name}_"))
        if not names:
            raise InputError(
                f"--vary {text}: {quoted(name)} is not a parameter that can be varied; vary one of {listing(known)}, {EXAMPLE}"
            )
        if again := [one for one in names if any(one in others for others in variations.values())]:
            raise InputError(f"--vary {text}: {again[0]} is varied twice; omit one of them")
        try:
            low, high = map(float, numbers)
        except ValueError:
            raise InputError(f"--vary {text} does not have the form NAME:LOW:HIGH with two factors, {EXAMPLE}") from None
        if not 0 < low <= high < math.inf:
            raise InputError(f"--vary {text}: give finite factors above 0, the smaller one first, {EXAMPLE}")
        variations[Variation(name.replace("_", " "), low, high)] = names
    if len(variations) > MOST:
        raise InputError(f"--vary names {len(variations)} quantities; vary at most {MOST}")
    with error_in("--vary reaches an invalid vehicle:"):
        _check_corners(vehicle, variations)
    return variations


def _usual(vehicle: Vehicle) -> dict[Variation, tuple[str, ...]]:
    """Returns the variations of the vehicle type, as far as all corners are vehicles."""
    for share in (0.5**i for i in range(HALVINGS)):
        usual = {
            replace(one, **{end: share * getattr(one, end) + (1 - share) for end in ("smallest", "largest")}): names
            for one, names in vehicle.kind.variations.items()
        }
        with suppress(InputError):
            _check_corners(vehicle, usual)
            return usual
    return {}


def _check_corners(vehicle: Vehicle, variations: Mapping[Variation, tuple[str, ...]]) -> None:
    """Refuses variations with an invalid vehicle at a corner: an invalid parameter, or a load that a spring's table lacks."""
    for corner in itertools.product(*((each.smallest, each.largest) for each in variations)):
        other = _with_factors(vehicle, variations, corner)
        vehicle.kind.check(other.parameters)
        _ = other.parts.with_curve


def robustness(
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    timestep: float,
    progress: Callable[[str], None] = no_progress,
    variations: Mapping[Variation, tuple[str, ...]] | None = None,
) -> list[Robustness | None]:
    """Returns the largest norm of each controller over the box, on a grid and refined from there, and the physics at its corners.

    Returns None for each controller if nothing varies, and for one whose stable loop has no finite norm.

    Args:
        vehicle: vehicle without adjustable dampers. Its curves follow the parameters; then those that bend at rest are lines.
        timestep: MuJoCo's timestep [s].
        progress: callback that receives a line on the progress.
        variations: result of `read_variations`; None for the variations of the vehicle type.
    """
    variations = read_variations(vehicle, ()) if variations is None else variations
    varied = tuple(variations)
    if not varied:
        return [None] * len(controllers)
    corners = list(itertools.product(*((each.smallest, each.largest) for each in varied)))
    others = [at_rest(_with_factors(vehicle, variations, corner)) for corner in corners]
    trials = [Trial(other, controller) for controller in controllers for other in others]
    progress(f"{len(trials)} runs")
    grows = [simulated_loop(step_derivative(trial.vehicle, timestep), trial).grows for trial in trials]
    physics = zip(grows, _agree(trials, sample_times(vehicle, DURATION, timestep)), strict=True)
    progress("")
    results: list[Robustness | None] = []
    for controller in controllers:
        at_corners = list(itertools.islice(physics, len(corners)))
        if controller.certificate.stable and math.isinf(controller.certificate.norm.value):
            results.append(None)
            continue

        @cache
        def norm(*factors: float, of: Controller = controller) -> float:
            """Returns the H-infinity norm on the vehicle with these factors, by one route; infinite if unstable."""
            gain = Gain(of.loop(_with_factors(vehicle, variations, factors)))
            return by_level_sets(gain)[0] if gain.stable else math.inf

        factors, norms, worst, at = _worst(norm, varied)
        vertices = tuple(
            ParameterVertex(corner, _changed(vehicle, variations, corner), norm(*corner), not grows, agrees)
            for corner, (grows, agrees) in zip(corners, at_corners, strict=True)
        )
        computed, loop = norm.cache_info().currsize, controller.loop(_with_factors(vehicle, variations, at))
        worst = hinf_norm(loop).value if math.isfinite(worst) else worst
        results.append(Robustness(varied, computed, worst, _changed(vehicle, variations, at), vertices, factors, norms))
    return results


def _worst(norm: Callable[..., float], varied: Sequence[Variation]) -> tuple[tuple[Array, ...], Array, float, Sequence[float]]:
    """Returns the factors of a grid over the box and the norms there, then the worst norm and its factors.

    Args:
        norm: function of as many factors as there are variations.
    """
    box = [(each.smallest, each.largest) for each in varied]
    count = max(3, round(GRID ** (1 / len(box))))
    factors = tuple(np.linspace(*ends, count) for ends in box)
    grid = list(itertools.product(*(axis.tolist() for axis in factors)))
    values = [norm(*point) for point in grid]
    worst, at = max(values), grid[int(np.argmax(values))]
    for i in np.argsort(values)[-3:] if math.isfinite(worst) else []:
        refined: Any = optimize.minimize(
            lambda point: -norm(*point.tolist()), grid[i], method="Nelder-Mead", bounds=box, options={"xatol": 1e-6}
        )
        if -refined.fun > worst:
            worst, at = -float(refined.fun), tuple(refined.x.tolist())
    return factors, np.reshape(values, (count,) * len(box)), worst, at


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows
def _agree(trials: Sequence[Trial], time: Array) -> list[bool]:
    """Returns True for each trial whose linear response over the bump MuJoCo confirms."""
    runs = record([Case(trial.vehicle, trial.controller, BUMP) for trial in trials], time, threads=0)
    predictions = [Prediction(run.input, trial.controller) for trial, run in zip(trials, runs, strict=True)]
    return [run.agreement.agrees for run in compare_runs(predictions, runs)]


def _changed(vehicle: Vehicle, variations: Mapping[Variation, tuple[str, ...]], factors: Sequence[float]) -> dict[str, float]:
    """The parameters of a vehicle on which there are these factors, one for each of the variations [SI]."""
    varied = zip(variations.values(), factors, strict=True)
    changed = {name: float(vehicle.parameters[name] * factor) for names, factor in varied for name in names}
    return {name: changed[name] for name in vehicle.parameters if name in changed}


def _with_factors(vehicle: Vehicle, variations: Mapping[Variation, tuple[str, ...]], factors: Sequence[float]) -> Vehicle:
    return vehicle.altered(_changed(vehicle, variations, factors))
