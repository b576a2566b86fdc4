"""The sections of a report on where the analysis ends: margins, other vehicles, the map of validity."""

from models.document.document import Document
from models.roads.road import Bump
from sim.report.scope import BUMP_DURATION, Scope
from sim.runs.run import sample_times
from sim.studies.frequency.identification import ideal_measurements
from sim.studies.validity.grid import grid, read_axes
from sim.studies.validity.regime_map import Cells, validity

MAP = ("height:0.02:0.3:20", "speed:3:30:20")


def margins_section(scope: Scope) -> Document:
    """Returns the section on margins, predicted and found."""
    # A quick report has no margins, and waits for none of their searches to be imported.
    from sim.studies.stability.report import compare
    from sim.studies.stability.study import stability_margins

    step = scope.margins_timestep
    return compare(stability_margins(scope.vehicle, scope.active, step, scope.progress, each_loop=False))


def map_of(scope: Scope, number: int) -> Cells:
    """Runs bumps of the paper's length, of every height and speed of `MAP`, with one of the active controllers."""
    bump, vehicle = Bump(), ideal_measurements(scope.vehicle)
    bumps = grid(read_axes(MAP), {"height": bump.height, "length": bump.length, "speed": bump.speed})
    return validity(vehicle, scope.active[number], bumps, sample_times(vehicle, BUMP_DURATION, scope.map_timestep))
