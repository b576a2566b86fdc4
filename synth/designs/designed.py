"""From designs of a plant to controllers of a vehicle."""

from collections.abc import Callable, Sequence

from models.common.errors import InputError
from models.controllers import ControllerEntry
from models.law import static_law
from models.vehicle import Vehicle
from synth.controller import Controller
from synth.design import Design
from synth.errors import BatchError, DesignError
from synth.problem.problem import measurements

STATE_ALONE = (
    "filters have states that nothing measures: this is a static gain on the vehicle's own, designed as any other "
    "output feedback is"
)


def designed(vehicle: Vehicle, entry: ControllerEntry, design: Design) -> Controller:
    """The controller of a gain on C_y x; a force that is in what is measured is taken out of it."""
    through = measurements(vehicle, entry.measured, entry.hardware.bandwidth)[1]
    beside = STATE_ALONE if entry.name == "state" and vehicle.filtered else ""
    redundant = tuple(entry.measured[i] for i in design.redundant)
    return Controller(
        entry.name,
        entry.measured,
        static_law(design.gain).fed_back(-through),
        designed=True,
        certificate=design.certificate,
        state_step_gap=design.state_step_gap,
        optimum_gap=design.optimum_gap,
        moved=design.moved,
        redundant=redundant,
        case="; ".join(said for said in (design.case, beside) if said),
        instead=design.instead,
        hardware=entry.hardware,
    )


def one_by_one(name: str, designs: Sequence[Callable[[], Controller]]) -> list[Controller]:
    """What each of many designs of one controller comes to.

    Args:
        name: of the controller.
        designs: each makes one, for a vehicle of its own.

    Raises:
        BatchError: some come to none; as `synth.designer.Designer.redesign` says.
    """
    found: dict[int, Controller] = {}
    failures: dict[int, InputError] = {}
    for i, make in enumerate(designs):
        try:
            found[i] = make()
        except DesignError as error:
            failures[i] = error
    if failures:
        whose, first = ", ".join(map(str, failures)), next(iter(failures.values()))
        raise BatchError(f"controller {name!r}: no design for vehicle(s) {whose}: {first}", found, failures)
    return [found[i] for i in range(len(designs))]
