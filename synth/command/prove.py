"""`python -m synth --prove`: a bound for a law that was given, as a designed one has it, by a Riccati equation."""

from dataclasses import replace

from synth.certificate.bounding import certify_tightly
from synth.controller import Controller
from synth.designer import Designer

UNPROVED = "no bound is proved: rounding leaves no X that satisfies LMI (20) near its norm"


def proved(designer: Designer, controller: Controller) -> tuple[Controller, tuple[str, ...]]:
    """A controller with a bound just above its norm, and what is said of it; as it is where it has one, or no loop to prove.

    Args:
        designer: of the vehicle.
        controller: one of the vehicle's.
    """
    certificate = controller.certificate
    if certificate.bound is not None or not certificate.stable or not controller.measured:
        return controller, ()
    posed = designer.problem(controller.measured, controller.hardware)
    found = certify_tightly(*posed.closed(controller.law), certificate.below, posed.plant)
    if found.bound is None:
        return controller, (UNPROVED,)
    return replace(controller, certificate=found), ("its law is given; its bound is proved here",)
