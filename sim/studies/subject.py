"""Subject of a report: the vehicle, the controllers, their runs over the road, and results that several sections of the report
use.
"""

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
from synth.controller.sampled_report import has_sampled_norm
from synth.vehicle.designer import Designer

BUMP_DURATION = 3.0  # s, time for which the vehicle drives over the bump
COARSER = 2.5  # largest timestep with which the map is computed, relative to the timestep of the report
AMPLITUDE = 1e-4  # m, amplitude of the sinusoidal roads for frequency responses
SPEED, SEEDS = 20.0, (0, 1, 2, 3)  # speed [m/s] and seeds of the random roads
AVERAGE = "C"  # class of the road on which the report compares the controllers


@dataclass(frozen=True, eq=False)
class Subject:
    """Subject of a report.

    Controllers are designed and certified for the *ideal loop*, which is continuous and has no limits. MuJoCo simulates the
    *implemented loop*, to which the sections `[limits]` and `[implementation]` of the vehicle file apply.

    Attributes:
        vehicle: vehicle that the report describes.
        designer: object that designs the controllers for the vehicle.
        controllers: controllers of the report that have a linear law.
        timestep: timestep of the simulation [s].
        quick: True to omit the stability margins, the map of validity and the ride on random roads.
        laws: controllers of the report to which linear analysis does not apply, which are laws in Python and semi-active laws.
        front: axes of a trade-off, in the syntax of the option `--front`; None if no trade-off is requested.
        loads: loads on the body that are simulated on a flat road.
        exported_controller: controller with exported code; None if there is no exported code.
        own_road: road that the report uses; None for the bump of the paper.
        road_name: name of the road as the user entered it.
        duration: duration of the runs over the road or the bump [s].
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
        """Road that is used in all runs: `own_road` or, if this is None, the bump of the paper."""
        return self.own_road or Bump()

    @property
    def where(self) -> str:
        """Short name of the road for sentences: "the road" or "the paper's bump"."""
        return "the road" if self.own_road is not None else "the paper's bump"

    @property
    def speed(self) -> float:
        """Speed on sinusoidal roads [m/s]: the speed on the report's road; for a test rig, the speed over the paper's bump."""
        return self.road.speed or Bump().speed

    @cached_property
    def time(self) -> Array:
        """Sample times of the runs over the road [s], shape (T,)."""
        return sample_times(self.vehicle, self.duration, self.timestep)

    @cached_property
    def runs(self) -> list[Run]:
        """Runs of all controllers over the report's road."""
        return run_controllers(self.vehicle, self.driven_controllers, self.road, self.time)

    @cached_property
    def samples(self) -> tuple[int, int | None]:
        """Index of the first measured sample, and index after the last measured sample; None for the end of the runs."""
        if self.own_road is None:
            return 0, None
        return measured_samples(
            [(self.vehicle, one) for one in self.driven_controllers], self.own_road, self.duration, self.timestep
        )

    @cached_property
    def run_metrics(self) -> list[RunMetrics]:
        """Metrics of the runs over `own_road`; empty if the road is the bump."""
        return [] if self.own_road is None else [measure_run(run, *self.samples) for run in self.runs]

    @property
    def disagreeing_names(self) -> list[str]:
        """Names of the stable controllers whose runs disagree with linear analysis."""
        wrong = {run.controller.name for run in self.runs if not run.agreement.agrees}
        return [one.name for one in self.stable if one.name in wrong]

    @property
    def driven_controllers(self) -> tuple[AnyController, ...]:
        """All controllers of the report, each simulated in MuJoCo."""
        return (*self.controllers, *self.laws)

    def unstable(self, controller: AnyController) -> bool:
        """Returns True if the controller is linear and either its ideal or its implemented loop is unstable."""
        return controller.linear and controller not in self.stable

    @property
    def noise_qualifier(self) -> str:
        """Text that names what the runs omit, such as ", without its noise"; empty if the vehicle has no noise and
        quantisation.
        """
        noise = self.vehicle.implementation.noise_text
        return f", without its {noise}" if noise else ""

    @cached_property
    def stable(self) -> list[Controller]:
        """Linear controllers with a stable implemented loop."""
        return [
            one
            for one in self.controllers
            if (one.certificate.stable or not self.vehicle.implementation.undelayed)
            and radius(loop_of(self.vehicle, one, self.timestep)) < 1
        ]

    @cached_property
    def built_norms(self) -> dict[str, SampledNorm]:
        """L2 gains of the implemented loops, by controller; empty if the implemented loops do not differ from the ideal loops."""
        vehicle = self.vehicle
        if vehicle.limits.actuator_bandwidth is None and vehicle.implementation.undelayed:
            return {}
        some = [one for one in self.stable if has_sampled_norm(vehicle, one)]
        return {one.name: norm_as_implemented(vehicle, one, self.timestep) for one in some}

    @cached_property
    def styles(self) -> dict[str, Style]:
        """Line style of each controller, identical in all figures of the report."""
        return styles(tuple(one.name for one in self.driven_controllers))

    @property
    def active(self) -> list[Controller]:
        """Controllers that have stability margins, because they command a force and their ideal and implemented loops are
        stable.
        """
        return [one for one in self.stable if one.law.acts and one.certificate.stable]

    @property
    def margins_timestep(self) -> float:
        """Timestep for the margins [s]: the default of `roadproof margins` or the report's timestep, whichever is smaller."""
        return min(TIMESTEP, self.timestep)

    @property
    def map_timestep(self) -> float:
        """Timestep for the runs of the validity map [s]: about twice the report's timestep, and a divisor of the sample
        period.
        """
        period = self.vehicle.implementation.sample_period or 2 * self.timestep
        step = period / math.ceil(period / (COARSER * self.timestep) - 1e-9)
        try:
            steps_per_sample(self.vehicle.implementation, step)
            sample_times(self.vehicle, BUMP_DURATION, step)
        except ValueError:
            return self.timestep
        return step


def file_stem(vehicle: Vehicle) -> str:
    """Returns the name of the vehicle file without the file suffix; if there is no file, the name of the vehicle type."""
    return Path(vehicle.source).stem if vehicle.source else vehicle.kind.name


NAME = Field[AnyController]("controller", lambda one: one.name)
