"""Runs with one vehicle file in `sim.bump` or `sim.drive`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from models.vehicle.names import logged_variant, variant
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.runs.record import HALF_STEP, RUN
from sim.runs.run import Run

if TYPE_CHECKING:
    from sim.studies.ride.run_metrics import RunMetrics
    from sim.studies.validity.measured_log import SignalFit


@dataclass(frozen=True, eq=False)
class VehicleRuns:
    """The runs with one vehicle file, and their results.

    Attributes:
        vehicle: vehicle that the file describes.
        title: title of the vehicle in printed results; empty if the command simulates only one vehicle.
        names: requested controllers.
        runs: runs with the whole vehicle file, followed by runs in which one part of the file is omitted (`--without`).
        without: part of the vehicle file that each run omits, such as noise; an empty text for a run that omits no part.
        passive: MuJoCo's response of the passive vehicle.
        metrics: ride metrics of each run; empty if the ride is not measured.
        fits: comparison of each run with a measured log; empty without a measured log.
    """

    vehicle: Vehicle
    title: str
    names: Sequence[str]
    runs: Sequence[Run]
    without: Sequence[str]
    passive: Response
    metrics: "Sequence[RunMetrics]" = ()
    fits: "Sequence[Mapping[str, SignalFit]]" = ()

    @property
    def implemented_runs(self) -> list[Run]:
        """The runs with the whole vehicle file, in which no part is omitted."""
        return [run for run, part in zip(self.runs, self.without, strict=True) if not part]

    @cached_property
    def named_runs(self) -> list[Run]:
        """The runs, renamed to the names that printed results use."""
        pairs = zip(self.runs, self.without, strict=True)
        return [_rename_run(run, f"{self.title}:{run.controller.name}{variant(part)}".removeprefix(":")) for run, part in pairs]

    def logged(self) -> dict[str, Run]:
        """Returns the runs by the names that they have in a log."""
        return {f"{run.controller.name}{logged_variant(part)}": run for run, part in zip(self.runs, self.without, strict=True)}

    @property
    def objects(self) -> list[dict[str, Any]]:
        """The runs as JSON objects. A JSON object includes the title of the vehicle and the omitted part if these are not
        empty.
        """
        return [
            RUN(run)
            | {"half_step": run.half_step and HALF_STEP(run.half_step)}
            | {key: text for key, text in (("vehicle", self.title), ("without", part)) if text}
            | ({"beside": {name: one.record for name, one in fits.items()}} if fits else {})
            for run, part, fits in zip_longest(self.runs, self.without, self.fits)
        ]


def _rename_run(run: Run, name: str) -> Run:
    if run.controller.name == name:
        return run
    controller: Any = run.controller  # type Any, because all driver classes are dataclasses with a field `name`
    return replace(run, prediction=replace(run.prediction, controller=replace(controller, name=name)))
