"""Subject of a page: the vehicle and its controllers, their loops, their runs over the road, and common results."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from models.common.arrays import Array
from models.document.field import Field
from models.document.figure import Style, styles
from models.roads.loads.load import Load
from models.roads.road import Bump, Road
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.ride.run_metrics import RunMetrics, measure_run, measured_samples
from sim.studies.stability import TIMESTEP
from synth.analysis.specification import SampledNorm
from synth.controller.controller import AnyController, Controller
from synth.controller.implementation_norm import norm_as_implemented
from synth.controller.loop_of import loop_of, radius
from synth.controller.report import has_sampled_norm
from synth.vehicle.designer import Designer

BUMP_DURATION = 3.0  # s
COARSER = 2.5  # times the report's step, at most that of the map
AMPLITUDE = 1e-4  # m, of the roads that frequency responses are identified on
SPEED, SEEDS = 20.0, (0, 1, 2, 3)  # speed [m/s] and seeds of the random roads
AVERAGE = "C"  # their class that controllers are compared on


@dataclass(frozen=True, eq=False)
class Subject:
    """Subject of a report.

    Designs and certificates are for the *ideal loop*, which is continuous and without limits. MuJoCo runs the *implemented loop*
    with `[limits]` and `[implementation]` of the vehicle file.

    Attributes:
        vehicle: the vehicle.
        designer: designer of the controllers.
        controllers: controllers that are reported and have a linear law.
        timestep: timestep of the physics [s].
        quick: True to omit margins, map and ride.
        laws: laws without linear analysis: laws in Python, and semi-active laws.
        front: the axes of a trade-off, in the form of `--front`; None without one.
        loads: loads on the body on a flat road.
        exported_controller: the controller whose exported code is reported; None without one.
        own_road: road of the report instead of the paper's bump; None for the bump.
        road_name: name of the road as given.
        duration: duration of the runs over either road [s].
    """

    vehicle: Vehicle
    designer: Designer
    controllers: tuple[Controller, ...]
    timestep: float
    quick: bool
    laws: tuple[AnyController, ...] = ()
    front: str | None = None
    loads: tuple[Load, ...] = ()
    exported_controller: AnyController | None = None
    own_road: Road | None = None
    road_name: str = ""
    duration: float = BUMP_DURATION

    @property
    def road(self) -> Road:
        """Returns the road that all is driven over."""
        return self.own_road or Bump()

    @property
    def where(self) -> str:
        """Returns that road in a few words."""
        return "the road" if self.own_road is not None else "the paper's bump"

    @property
    def speed(self) -> float:
        """Returns the speed over sinusoids [m/s]: that of the road, or of the paper's bump if the vehicle is on a rig."""
        return self.road.speed or Bump().speed

    @cached_property
    def time(self) -> Array:
        """Returns the sample times of the runs over the road [s]."""
        return sample_times(self.vehicle, self.duration, self.timestep)

    @cached_property
    def runs(self) -> list[Run]:
        """Returns the run of every controller over the road."""
        return run_controllers(self.vehicle, self.driven_controllers, self.road, self.time)

    @cached_property
    def samples(self) -> tuple[int, int | None]:
        """Returns the first measured sample, and the one after the last; None for the end of the runs."""
        if self.own_road is None:
            return 0, None
        return measured_samples(
            [(self.vehicle, one) for one in self.driven_controllers], self.own_road, self.duration, self.timestep
        )

    @cached_property
    def run_metrics(self) -> list[RunMetrics]:
        """Returns the metrics of the runs over a road of the report's own; empty for the bump."""
        return [] if self.own_road is None else [measure_run(run, *self.samples) for run in self.runs]

    @property
    def disagreeing_names(self) -> list[str]:
        """Returns the names of the stable controllers whose runs do not agree."""
        wrong = {run.controller.name for run in self.runs if not run.agreement.agrees}
        return [one.name for one in self.stable if one.name in wrong]

    @property
    def driven_controllers(self) -> tuple[AnyController, ...]:
        """Returns all controllers that MuJoCo runs."""
        return (*self.controllers, *self.laws)

    def unstable(self, controller: AnyController) -> bool:
        """Returns True if a loop is known to be unstable, ideal or implemented."""
        return controller.linear and controller not in self.stable

    @property
    def noise_qualifier(self) -> str:
        """Returns the noise and quantisation that a linear loop omits, after a comma; empty without them."""
        noise = self.vehicle.implementation.noise_text
        return f", without its {noise}" if noise else ""

    @cached_property
    def stable(self) -> list[Controller]:
        """Returns the controllers with a stable implemented loop, and a stable ideal loop unless a computer replaces it."""
        return [
            one
            for one in self.controllers
            if (one.certificate.stable or not self.vehicle.implementation.undelayed)
            and radius(loop_of(self.vehicle, one, self.timestep)) < 1
        ]

    @cached_property
    def built_norms(self) -> dict[str, SampledNorm]:
        """Returns the L2 gains of the implemented loops, by controller, if these differ from the ideal loops."""
        vehicle = self.vehicle
        if vehicle.limits.actuator_bandwidth is None and vehicle.implementation.undelayed:
            return {}
        some = [one for one in self.stable if has_sampled_norm(vehicle, one)]
        return {one.name: norm_as_implemented(vehicle, one, self.timestep) for one in some}

    @cached_property
    def styles(self) -> dict[str, Style]:
        """Returns the style of each controller, the same in every figure of the page."""
        return styles(tuple(one.name for one in self.driven_controllers))

    @property
    def active(self) -> list[Controller]:
        """Returns the stable controllers that act and whose ideal loop is stable, so that it has margins."""
        return [one for one in self.stable if one.law.acts and one.certificate.stable]

    @property
    def margins_timestep(self) -> float:
        """Returns the timestep of the margins [s]: that of `python -m sim.margins`, or the report's if that is finer."""
        return min(TIMESTEP, self.timestep)

    @property
    def map_timestep(self) -> float:
        """Returns the timestep of the map's runs [s]: about twice the report's, a divisor of the controller's sample period."""
        period = self.vehicle.implementation.sample_period or 2 * self.timestep
        step = period / math.ceil(period / (COARSER * self.timestep) - 1e-9)
        try:
            steps_per_sample(self.vehicle.implementation, step)
            sample_times(self.vehicle, BUMP_DURATION, step)
        except ValueError:
            return self.timestep
        return step


def file_stem(vehicle: Vehicle) -> str:
    """Returns the name of a vehicle's file without its suffix, or its type if it has no file."""
    return Path(vehicle.source).stem if vehicle.source else vehicle.kind.name


NAME = Field[AnyController]("controller", lambda one: one.name)
