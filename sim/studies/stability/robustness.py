"""A controller on other vehicles than its own: the worst norm over a box of parameters, and the physics at its corners.

Which parameters vary, and how far, is the kind's to say: `Parameter.varied`.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.lean_scipy import optimize
from models.kinds.kind import Variation, VehicleKind
from models.roads.road import Bump, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.physics.simulate import simulate
from sim.runs.prediction import predict
from sim.runs.run import compare_runs, sample_times
from sim.studies.stability.growth_test import Trial, grows, no_progress
from synth.analysis.norm import hinf_norm
from synth.controller.controller import Controller
from synth.controller.open_loop import LoopModel

GRID = 81  # norms that are taken first, whatever the box's dimension
BUMP = Bump(height=2e-2, track="left")  # high enough for what geometry makes to be told from rounding


@dataclass(frozen=True)
class ParameterVertex:
    """A vehicle with other parameters than its controller was designed for.

    Attributes:
        factors: on what varies.
        parameters: those that are others [SI].
        norm: the H-infinity norm; infinite where unstable.
        decays: whether MuJoCo settles after a small bump.
        agrees: whether it agrees with the linear response over one.
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
        varied: what varies, d of them.
        norm: the largest H-infinity norm.
        at: where it is, the parameters that are others [SI].
        corners: of the box.
        factors: of the vehicles whose norms were taken first, evenly over the box, along each of its d axes.
        norms: of those; infinite where unstable.
    """

    varied: tuple[Variation, ...]
    norm: float
    at: dict[str, float]
    corners: tuple[ParameterVertex, ...]
    factors: tuple[Array, ...]
    norms: Array

    @property
    def holds(self) -> bool:
        """Returns True if physics and analysis agree at every corner."""
        return all(corner.agrees and corner.decays == math.isfinite(corner.norm) for corner in self.corners)


def varied_text(kind: VehicleKind) -> str:
    """Describes the variations of a kind of vehicle."""
    return ", ".join(map(str, kind.variations)) or f"nothing is varied: no parameter of a {kind.name} says how far it varies"


def robustness(
    vehicle: Vehicle, controllers: Sequence[Controller], timestep: float, progress: Callable[[str], None] = no_progress
) -> list[Robustness | None]:
    """Returns the worst norm of each controller over the box, on a grid and refined from there, and the physics at its corners.

    Returns None for each controller if the kind of vehicle has no variations.
    """
    varied = tuple(vehicle.kind.variations)
    if not varied:
        return [None] * len(controllers)
    corners = list(itertools.product(*((each.smallest, each.largest) for each in varied)))
    others = [_with_factors(vehicle, corner) for corner in corners]
    trials = [Trial(other, controller) for controller in controllers for other in others]
    physics = zip(grows(trials, timestep, progress), _agree(trials, sample_times(vehicle, 3.0, timestep)), strict=True)
    results: list[Robustness | None] = []
    for controller in controllers:
        norm = functools.partial(_norm, vehicle, controller)
        factors, norms, worst, at = _worst(norm, varied)
        results_at_corners = itertools.islice(physics, len(corners))
        results.append(
            Robustness(
                varied=varied,
                norm=worst,
                at=_changed(vehicle, at),
                corners=tuple(
                    ParameterVertex(corner, _changed(vehicle, corner), norm(corner), not growth.grows, agrees)
                    for corner, (growth, agrees) in zip(corners, results_at_corners, strict=True)
                ),
                factors=factors,
                norms=norms,
            )
        )
    return results


def _norm(vehicle: Vehicle, controller: Controller, factors: Sequence[float]) -> float:
    """The H-infinity norm on the vehicle with these factors; infinite where unstable."""
    other = _with_factors(vehicle, factors)
    return hinf_norm(controller.loop(other)).value


def _worst(
    norm: Callable[[Sequence[float]], float], varied: Sequence[Variation]
) -> tuple[tuple[Array, ...], Array, float, Sequence[float]]:
    """The factors of a grid over the box and the norms there, then the worst norm and where that is."""
    box = [(each.smallest, each.largest) for each in varied]
    count = max(3, round(GRID ** (1 / len(box))))
    factors = tuple(np.linspace(*ends, count) for ends in box)
    grid = list(itertools.product(*(axis.tolist() for axis in factors)))
    values = [norm(point) for point in grid]
    worst, at = max(values), grid[int(np.argmax(values))]
    for i in np.argsort(values)[-3:] if math.isfinite(worst) else []:
        refined: Any = optimize.minimize(
            lambda point: -norm(point), grid[i], method="Nelder-Mead", bounds=box, options={"xatol": 1e-6}
        )
        if -refined.fun > worst:
            worst, at = -float(refined.fun), tuple(refined.x)
    return factors, np.reshape(values, (count,) * len(box)), worst, at


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows
def _agree(trials: Sequence[Trial], time: Array) -> list[bool]:
    """Returns True for each trial whose linear response over the bump MuJoCo confirms; all run in one batch."""
    controllers, inputs = [trial.controller for trial in trials], [RoadInput(trial.vehicle, BUMP, time) for trial in trials]
    predictions = [predict(LoopModel(on.vehicle, one, on.timestep), on) for one, on in zip(controllers, inputs, strict=True)]
    response = simulate(controllers, inputs, threads=0).response
    return [run.agreement.agrees for run in compare_runs(predictions, [response.run(i) for i in range(len(trials))])]


def _changed(vehicle: Vehicle, factors: Sequence[float]) -> dict[str, float]:
    """The parameters of a vehicle on which there are these factors, one for each of its kind's variations [SI]."""
    varied = zip(vehicle.kind.variations.values(), factors, strict=True)
    changed = {name: float(vehicle.parameters[name] * factor) for names, factor in varied for name in names}
    return {name: changed[name] for name in vehicle.parameters if name in changed}


def _with_factors(vehicle: Vehicle, factors: Sequence[float]) -> Vehicle:
    return replace(vehicle, parameters={**vehicle.parameters, **_changed(vehicle, factors)})
