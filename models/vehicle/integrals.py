"""Checks that controllers and weights with an integrator can be combined with the other options of a vehicle file."""

from collections.abc import Mapping

from models.common.errors import InputError
from models.vehicle.controllers import ControllerEntry

SAMPLED_REFUSAL = "a sampled controller drives only the sum of its samples to zero, so the norm of the integral is not finite"


def check_integrals(
    entry: ControllerEntry, integrals: Mapping[str, Mapping[str, float]], heard: Mapping[str, float], sampled: bool
) -> None:
    """Checks that every integral in z has a finite norm, and that the designed law has a state for each of these integrals.

    Args:
        entry: controller to be checked.
        integrals: integrated signals in the controlled output z of the vehicle, by name of the integrator state.
        heard: rms value of the implementation's sensor noise, by signal.
        sampled: True if the controllers are designed for the sampled loop.

    Raises:
        InputError: the controller cannot be combined with an integral. The message gives the reason and an alternative.
    """
    if not entry.linear:
        return
    request, structure = entry.request, entry.request.structure
    noisy = dict(zip(entry.measured, entry.hardware.noise, strict=bool(entry.hardware.noise)))
    if request.design == "lqg":
        noisy |= {name: rms for name, rms in heard.items() if name in entry.measured}
    # The noise of a signal is integrated only if the law measures all signals of the integrated sum.
    integrated = [name for terms in integrals.values() if {*terms} <= {*entry.measured} for name in terms if noisy.get(name)]
    refused = {
        f"{SAMPLED_REFUSAL}; omit sampled": sampled or request.sampled,
        "the law measures heights above a flat datum, which cannot return the integral to zero": entry.study,
        "goals are for static gains, which contain no integral; give a design or an order instead": entry.goals is not None,
        "tolerance has an error that depends on frequency; give this error as a number, or omit the pole at 0": entry.errors,
        "the law then has an integrator, so the law alone is not stable; omit stable": request.stable,
        "a law with a structure has no state for it; give order = 2 without structure, or a design": (
            structure is not None and (structure.kind or structure.rows is not None)
        ),
        f"the law would also integrate the noise on {''.join(integrated[:1])}, so there is no finite norm; omit this noise, or "
        "give a filter without a pole at 0": integrated,
    }
    integral = f"the integral of {next(iter(integrals)).removeprefix('integral_of_')} in [performance]"
    for why, holds in refused.items():
        if holds:
            raise InputError(f"[controllers.{entry.name}] cannot be combined with {integral}: {why}")
