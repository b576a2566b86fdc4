"""A controller on other vehicles than its own: the worst norm over a box of parameters, and the physics at its corners."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import optimize

from models.arrays import Array
from models.vehicle import Vehicle
from sim.growth import Trial, grow, silent
from sim.road import Bump
from sim.run import run_all, sample_times
from synth.controller import Controller, generalized_plant
from synth.norm import hinf_norm

MASS, TYRES = "sprung_mass", "tyre_stiffness"
BOX = {MASS: (0.7, 1.4), TYRES: (0.75, 1.25)}
BUMP = Bump(height=2e-2, track="left")  # high enough for what geometry makes to be told from rounding


@dataclass(frozen=True)
class Corner:
    """A vehicle with other parameters than its controller was designed for.

    Attributes:
        parameters: those that are others [SI].
        norm: the H-infinity norm; infinite where unstable.
        decays: whether MuJoCo settles after a small bump.
        agrees: whether it agrees with the linear response over one.
    """

    parameters: dict[str, float]
    norm: float
    decays: bool
    agrees: bool


@dataclass(frozen=True, eq=False)
class Robustness:
    """A controller on a box of sprung masses and tyre stiffnesses.

    Attributes:
        norm: the largest H-infinity norm.
        at: where it is, the parameters that are others [SI].
        corners: of the box.
        factors: on mass and on stiffness of the vehicles whose norms were taken first, evenly over the box.
        norms: of those, shape (len(factors[0]), len(factors[1])).
    """

    norm: float
    at: dict[str, float]
    corners: tuple[Corner, ...]
    factors: tuple[Array, Array]
    norms: Array

    @property
    def holds(self) -> bool:
        """Whether physics and analysis say the same at every corner."""
        return all(corner.agrees and corner.decays == math.isfinite(corner.norm) for corner in self.corners)


def robustness(vehicle: Vehicle, controller: Controller, timestep: float, progress: Callable[[str], None] = silent) -> Robustness:
    """The worst norm over the box, on a grid and refined from there, and the physics at its corners."""

    def norm(point: Sequence[float]) -> float:
        other = _with_factors(vehicle, *point)
        return hinf_norm(generalized_plant(other).closed_loop(controller.state_gain(other))).value

    masses, tyres = np.linspace(*BOX[MASS], 9), np.linspace(*BOX[TYRES], 7)
    grid = [(float(m), float(k)) for m in masses for k in tyres]
    values = [norm(point) for point in grid]
    worst, at = max(values), grid[int(np.argmax(values))]
    for i in np.argsort(values)[-3:] if math.isfinite(worst) else []:
        refined: Any = optimize.minimize(
            lambda point: -norm(point), grid[i], method="Nelder-Mead", bounds=list(BOX.values()), options={"xatol": 1e-6}
        )
        if -refined.fun > worst:
            worst, at = -float(refined.fun), tuple(refined.x)

    corners = [(m, k) for m in BOX[MASS] for k in BOX[TYRES]]
    vehicles = [_with_factors(vehicle, *corner) for corner in corners]
    time = sample_times(vehicle, 3.0, timestep)
    settled = [not growth.grows for growth in grow([Trial(other, controller) for other in vehicles], timestep, progress)]
    runs = [run_all(other, [controller], BUMP, time)[0] for other in vehicles]
    return Robustness(
        norm=worst,
        at=_changed(vehicle, *at),
        corners=tuple(
            Corner(_changed(vehicle, *corner), norm(corner), decays, run.agreement.agrees)
            for corner, decays, run in zip(corners, settled, runs, strict=True)
        ),
        factors=(masses, tyres),
        norms=np.reshape(values, (len(masses), len(tyres))),
    )


def _changed(vehicle: Vehicle, mass: float, tyres: float) -> dict[str, float]:
    """The parameters of a vehicle whose sprung mass and tyre stiffnesses are multiplied [SI]."""
    factors = {MASS: mass, TYRES: tyres}
    return {
        name: float(value * factor)
        for name, value in vehicle.parameters.items()
        for start, factor in factors.items()
        if name.startswith(start)
    }


def _with_factors(vehicle: Vehicle, mass: float, tyres: float) -> Vehicle:
    return replace(vehicle, parameters={**vehicle.parameters, **_changed(vehicle, mass, tyres)})
