"""`python -m synth --check` and `--prove`: check the claims of gains and laws in a vehicle file, or prove bounds for them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.command import chosen_controllers
from models.common.errors import InputError, list_names
from models.vehicle.vehicle import ControllerEntry
from synth.analysis.bounding import certify_tightly
from synth.analysis.specification import Specification
from synth.command.table import Row
from synth.controller.controller import Controller
from synth.controller.implementation_norm import false_sampled_bound
from synth.controller.report import judged_lines
from synth.controller.sampled_report import failures_of_sampled_loop, false_norm, norm_or_failure, notes_on_sampled_loop
from synth.vehicle.certified_vehicle import changed_since
from synth.vehicle.designer import Designer


def check(designer: Designer, names: Sequence[str] | None) -> list[Row]:
    """Checks all gains and laws of the vehicle file, or only the requested controllers, and returns one table row for each.

    Args:
        designer: designer of the vehicle.
        names: names of the requested controllers; None for all controllers that have a gain or a law.

    Raises:
        InputError: a name is unknown, a named controller or the whole file has no gain or law, or a certificate is malformed.
    """
    vehicle = designer.vehicle
    gains = [name for name, entry in vehicle.controllers.items() if entry.law is not None]
    if not gains:
        raise InputError(
            f"{vehicle.source} contains no gain or law to check; first design a controller, and save the controller with --save"
        )
    for name in names or ():
        if name in vehicle.controller_names and name not in gains:
            raise InputError(f"--check: {name!r} has no gain or law in {vehicle.source}; give one of {list_names(gains)}")
    return [_check_row(designer, vehicle.controllers[name]) for name in chosen_controllers(gains, names, gains)]


def _check_row(designer: Designer, entry: ControllerEntry) -> Row:
    assert entry.law is not None
    certificate, failures = designer.checked(entry)
    kept: tuple[Specification, ...] = ()
    if entry.goals is not None:
        from synth.vehicle.multi_objective import verify_specifications

        kept = verify_specifications(designer.vehicle, entry, entry.goals, entry.law, search=False)
    controller = designer.judged(
        Controller(entry.name, entry.measured, entry.law, False, certificate, hardware=entry.hardware, specifications=kept)
    )
    failures += controller.unmet_specifications
    norm, why = norm_or_failure(designer.vehicle, controller)
    failures = (*failures_of_sampled_loop(designer.vehicle, certificate, failures, norm), *why)
    failures += false_sampled_bound(designer.vehicle, entry)
    failures += false_norm(entry.certificate, designer.vehicle, lambda: norm)
    others = (certificate.stability.words, *controller.unmet_specifications, *why)
    if entry.certificate and {*failures} - {*others} and (changed := changed_since(designer.vehicle, entry)):
        failures = (changed, *(each for each in failures if each in others))
    note = "checked: every claim of the saved certificate holds" if entry.certificate and not failures else ""
    note = note or ("its saved certificate does not hold" if entry.certificate else "the file has no certificate for it")
    said = (*judged_lines(controller), *controller.remarks, *notes_on_sampled_loop(designer.vehicle, certificate, norm), note)
    return Row(entry.name, controller, said, failures, sampled=norm)


UNPROVED_BOUND = "no bound is proved, because rounding leaves no X that satisfies LMI (20) near the norm"


def prove_controller(designer: Designer, controller: Controller) -> tuple[Controller, tuple[str, ...]]:
    """Returns the controller with a proved bound just above the norm of its loop, and notes about the proof.

    The controller is unchanged if its bound is already proved, or if the norm of its loop is not finite.
    """
    certificate = controller.certificate
    if certificate.bound is not None or not np.isfinite(certificate.norm.value) or not controller.measured:
        return controller, ()
    judged = designer.problem(controller.measured, controller.hardware).judged(controller.law)
    certified = certify_tightly(judged.plant, judged.G, certificate.below, judged.plant_without_law)
    if certified.bound is None:
        return controller, (UNPROVED_BOUND,)
    return replace(controller, certificate=certified), ("the law is from the vehicle file, and its bound is proved here",)
