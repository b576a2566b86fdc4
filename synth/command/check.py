"""`python -m synth --check`: the gains and laws of a vehicle file against what is claimed of them. No solver, no design."""

from collections.abc import Sequence

from models.common.command import chosen
from models.common.errors import InputError, listing
from models.vehicle import ControllerEntry
from synth.command.table import Row
from synth.controller import Controller
from synth.designer import Designer
from synth.designs.goals import promises_of
from synth.implemented.claims import failures_as_it_runs, false_norm, norm_if_implemented, notes_as_it_runs
from synth.words import judged_lines


def check(designer: Designer, names: Sequence[str] | None) -> list[Row]:
    """A row for every gain or law of the vehicle file, or for those asked for.

    Raises:
        InputError: a name is unknown or has none, there is none at all, or a certificate is malformed.
    """
    vehicle = designer.vehicle
    gains = [name for name, entry in vehicle.controllers.items() if entry.law is not None]
    if not gains:
        raise InputError(f"{vehicle.source} holds no controller with a gain or law to check; write one with --save")
    for name in names or ():
        if name in vehicle.controller_names and name not in gains:
            raise InputError(f"--check: {name!r} has no gain or law in {vehicle.source}; with one there are {listing(gains)}")
    return [_checked(designer, vehicle.controllers[name]) for name in chosen(gains, names, gains)]


def _checked(designer: Designer, entry: ControllerEntry) -> Row:
    assert entry.law is not None
    certificate, failures = designer.checked(entry)
    kept = promises_of(designer.vehicle, entry, entry.law, search=False)
    controller = Controller(entry.name, entry.measured, entry.law, False, certificate, hardware=entry.hardware, promises=kept)
    failures += controller.broken
    norm = norm_if_implemented(designer.vehicle, controller)
    failures = failures_as_it_runs(designer.vehicle, certificate, failures, norm)
    failures += false_norm(entry.certificate, designer.vehicle, lambda: norm)
    note = "checked: every claim of its certificate holds" if entry.certificate and not failures else ""
    note = note or ("its certificate does not hold" if entry.certificate else "came without a certificate")
    said = (*judged_lines(controller), *notes_as_it_runs(designer.vehicle, certificate, norm), note)
    return Row(entry.name, controller, said, failures, sampled=norm)
