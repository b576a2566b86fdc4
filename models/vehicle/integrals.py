"""Controllers and weights with an integral: the compatible options, and the reasons against others."""

from collections.abc import Mapping

from models.common.errors import InputError
from models.vehicle.controllers import ControllerEntry

SAMPLED = "a computer sums its readings, and only that sum returns to zero: the integral between them has no norm"


def check_integrals(
    entry: ControllerEntry, integrals: Mapping[str, Mapping[str, float]], heard: Mapping[str, float], sampled: bool
) -> None:
    """Refuses a design for which an integral in z has no norm, or that has no room for its state.

    Args:
        entry: a controller.
        integrals: integrals of the vehicle's z, by name of the state.
        heard: noise of its sensors, an rms by signal.
        sampled: True if its designs are for the sampled loop.

    Raises:
        InputError: the reason, and what to give instead.
    """
    if not entry.linear:
        return
    weighed = next(iter(integrals)).removeprefix("integral_of_")
    where = f"[controllers.{entry.name}] and the integral of {weighed} in [performance]:"
    if sampled or entry.sampled:
        raise InputError(f"{where} the design is for the sampled loop, and {SAMPLED}; omit sampled")
    if entry.study:
        raise InputError(f"{where} the law measures heights over the datum of a flat road, which leave no integral at zero")
    if entry.goals is not None:
        raise InputError(f"{where} goals are for static gains, which have no integral; give a design or an order instead")
    if entry.errors is not None:
        raise InputError(
            f"{where} an error that is weighted by frequency acts ahead of it; give the error as a number, or omit the pole at 0"
        )
    if entry.stable:
        raise InputError(f"{where} its law has an integrator, a pole at 0, which is not stable by itself; omit stable")
    if entry.structure is not None and (entry.structure.kind or entry.structure.rows is not None):
        raise InputError(f"{where} a law with a structure has no state for it; give order = 2 without structure, or a design")
    noisy = dict(zip(entry.measured, entry.hardware.noise, strict=bool(entry.hardware.noise)))
    if entry.design == "lqg":
        noisy |= {name: rms for name, rms in heard.items() if name in entry.measured}
    for terms in integrals.values():
        if set(terms) <= set(entry.measured) and (louder := [name for name in terms if noisy.get(name)]):
            raise InputError(
                f"{where} the law integrates the noise of {louder[0]} with it, without bound: there is no norm; omit "
                "that noise, or give a filter without a pole at 0"
            )
