"""The report section about a trade-off: the front of designs, the proved lower bound, and the measured gains of some designs in
MuJoCo.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from models.common.errors import InputError
from models.document.document import Document, notes
from models.document.field import Field
from models.vehicle.vehicle import Vehicle
from sim.studies.frequency.identification import ideal_measurements, settled_gain
from sim.studies.frequency.sinusoids import drive_periodic, settled_sinusoid, whole_periods
from sim.studies.study import Progress, Study
from sim.studies.subject import AMPLITUDE, Subject
from synth.analysis.norm import largest_singular_values
from synth.command.trade_off import others_of, usual
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of, radius
from synth.plant.numerics import DesignError
from synth.vehicle.multi_objective import with_outputs_of_norm
from synth.vehicle.trade_off.axes import FrontAxis, axes_of
from synth.vehicle.trade_off.continuation import rays_of
from synth.vehicle.trade_off.front import DESIGNS, Front, entry_of, front
from synth.vehicle.trade_off.report import describe

SLOW = np.geomspace(1e-3, 1.0, 400)  # rad/s, frequencies at which a run is tried if the norm is reached at frequency 0
TURN = 0.005  # rad, largest change of the sinusoid's phase in one timestep
NEXT = 1e-3  # largest relative gap between the gain and the norm, if the norm is reached at frequency 0
TITLE = "Trade-off between objectives"


def front_section(scope: Subject, progress: Callable[[str], None]) -> Document:
    """Returns the section about the trade-off of the default controller, or a section that explains why there is no trade-off."""
    vehicle, name, given = scope.vehicle, usual(scope.vehicle), scope.front
    assert given is not None, "no axes"
    axes = axes_of(vehicle, given)
    total = rays_of(len(axes), DESIGNS)
    try:
        trade_off = front(vehicle, name, axes, others_of(vehicle), DESIGNS, lambda done: progress(f"{done} of {total} designs"))
    except DesignError as error:
        return Document(TITLE, notes(f"There is no trade-off: {error}"))
    if not trade_off.points:
        return Document(
            TITLE, notes(f"There is no trade-off, because no claim about the {trade_off.design_count} designs could be proved.")
        )
    measured = np.array([[measure(scope, trade_off, i, axis) for axis in axes] for i in trade_off.marked])
    norms = np.array([trade_off.points[i].values for i in trade_off.marked])
    document, texts = describe(trade_off, measured), []
    with np.errstate(all="ignore"):
        shares = (measured / norms)[np.isfinite(measured) & (norms > 0)]
    if len(shares):
        together = ", with all wheels on one road, which need not be the worst" if len(vehicle.kind.wheels) > 1 else ""
        texts.append(
            f"MuJoCo reaches {SHARE.digits(shares.min())} to {SHARE.digits(shares.max())} % of the continuous norms on the "
            f"sinusoid where each norm is reached{together}. The phase of the sinusoid advances by at most {TURN:g} rad per "
            "timestep."
        )
    return replace(document, blocks=(*document.blocks, *notes(*texts)))


SHARE = Field[float]("share", lambda share: share, ".2f", 100)


def measure(scope: Subject, trade_off: Front, i: int, axis: FrontAxis, turn: float = TURN) -> float:
    """Returns the gain of a design in MuJoCo on the sinusoidal road at which its norm is reached; NaN if this gain cannot be
    measured.

    Args:
        scope: subject of the report, with its vehicle, controllers and runs.
        trade_off: front of designs for two objectives, already computed.
        i: index of the design on the front.
        axis: objective on one axis of the front; this objective defines the norm.
        turn: largest allowed phase advance of the sinusoid in one timestep [rad].
    """
    controller, k = trade_off.points[i].controller, trade_off.axes.index(axis)
    norm = trade_off.points[i].norms[k]
    if axis.off or not norm.value or controller.hardware.loads or any(controller.hardware.noise):
        return 0.0 if not norm.value else math.nan
    vehicle = ideal_measurements(with_outputs_of_norm(scope.vehicle, axis.norm))
    omega = _driven_at(vehicle, controller, norm.value, norm.at)
    if not np.isfinite(omega):
        return math.nan
    step = scope.timestep / math.ceil(omega * scope.timestep / turn)
    if not radius(loop_of(vehicle, controller, step)) < 1:
        return math.nan
    road = settled_sinusoid(*whole_periods(omega, step), AMPLITUDE, step, 12.5)
    try:
        (run,) = drive_periodic(vehicle, [controller], [road], step)
    except InputError:  # this error means that the run would have too many samples
        return math.nan
    return settled_gain(vehicle, run.last_periods(), road.omega[0])


def _driven_at(vehicle: Vehicle, controller: Controller, norm: float, at: float) -> float:
    """Returns a frequency [rad/s] that is high enough for a MuJoCo run and at which the norm is (nearly) reached; NaN if none
    exists.

    Args:
        vehicle: vehicle whose outputs define the norm.
        controller: controller that closes the loop.
        norm: value of the loop's H-infinity norm.
        at: frequency at which the loop reaches the norm [rad/s]; may be 0.
    """
    if at >= SLOW[0]:
        return at
    loop = controller.loop(vehicle)
    gains = largest_singular_values(loop.frequency_response(SLOW))
    near = SLOW[gains >= norm * (1 - NEXT)]
    return float(near[-1]) if len(near) else math.nan


class FrontStudy(Study[Document]):
    """Study that adds a trade-off between two objectives to a report, and simulates some of the designs in MuJoCo."""

    seconds = 30.0

    def check_page(self, scope: Subject) -> None:
        """Checks the two axes of the front, and that the default controller can be the basis of its designs."""
        if scope.front is not None:
            axes_of(scope.vehicle, scope.front)
            entry_of(scope.vehicle, usual(scope.vehicle))

    def requests(self, scope: Subject) -> Mapping[str, Subject]:
        """Returns the request for a trade-off, if the axes of the front are set."""
        return {} if scope.front is None else {"": scope}

    def run(self, request: Subject, progress: Progress) -> Document:
        """Returns the report section about the trade-off between two objectives."""
        return front_section(request, progress)
