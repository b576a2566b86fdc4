"""Norms of sampled-data loops: when there is one, and texts and JSON about it."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.printed import NORM_DIGITS
from models.document.field import Field, Record
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.analysis.specification import ABOVE, SAMPLED_NORM, SampledNorm
from synth.controller.controller import Controller
from synth.controller.problem import road_twist_inputs
from synth.controller.report import norm_if_implemented
from synth.plant.numerics import INTEGRATOR_POLE

# allowed relative difference between the norms that two computers compute; a multiple of the distance between the levels that
# enclose the norm
SAME = 10 * ABOVE
ROUTES_AGREE = 1e-6  # largest allowed relative difference between a norm and the gain that an actual disturbance reaches
NORM_AS_IMPLEMENTED = Field[SampledNorm]("sampled", lambda one: one.value if one.stable else "UNSTABLE", NORM_DIGITS)
REACHED_GAIN = Field[SampledNorm]("reached by a road", lambda one: one.reached, NORM_DIGITS)
APART = Field[SampledNorm]("difference", lambda one: one.gap, ".0e")
PROOF = Record[SampledNorm](
    above="lower",
    below="upper",
    reached="reached",
    angle="angle",
    decided_within_a_period="inside",
)  # two levels that enclose a finite norm
PROVED_NORM = Record[SampledNorm](
    **{SAMPLED_NORM: lambda norm: norm.value, f"{SAMPLED_NORM}_proof": PROOF.all(lambda norm: norm if norm.stable else None)}
)


def norm_of_sampled_loop(vehicle: Vehicle, controller: Controller, timestep: float) -> SampledNorm | None:
    """Returns the norm of a sampled-data loop; None for a stable loop without a norm. See `norm_if_implemented`."""
    implemented = FEATURES.load("norm as implemented")
    if not has_sampled_norm(vehicle, controller) and FEATURES.load("sampled norm").stable(
        implemented.sampled_loop(vehicle, controller, timestep)
    ):
        return None
    return implemented.norm_as_implemented(vehicle, controller, timestep)


def has_sampled_norm(vehicle: Vehicle, controller: Controller) -> bool:
    """Returns True if the sampled-data loop can have a norm.

    The sampled-data loop has no norm if the continuous loop is stable without a norm, or if measured heights contain the road's
    warp.
    """
    model, norm = vehicle.linear_model, controller.certificate.norm.value
    heights = [model.outputs.index(name) for name in model.over_datum(controller.measured)]
    warped = np.abs(model.Cr[heights] @ road_twist_inputs(model).T).max(initial=0.0) > INTEGRATOR_POLE
    return not (warped or (controller.certificate.stable and math.isinf(norm)))


def norm_or_failure(vehicle: Vehicle, controller: Controller) -> tuple[SampledNorm | None, tuple[str, ...]]:
    """Returns the result of `norm_if_implemented`, or None and the reason if the law cannot run at the sample period."""
    try:
        return norm_if_implemented(vehicle, controller), ()
    except InputError as error:
        return None, (str(error).removeprefix(f"controller {controller.name!r}: "),)


def built_words(vehicle: Vehicle) -> str:
    """Describes the linear parts of an implementation; the norm of the sampled-data loop takes these parts into account."""
    lag = Limits(actuator_bandwidth=vehicle.limits.actuator_bandwidth)
    return ", ".join((*vehicle.implementation.without_noise.phrases, *lag.phrases(())))


def norm_failures(norm: SampledNorm | None) -> tuple[str, ...]:
    """Describes the checks of a sampled-data norm that failed."""
    if norm is None or not norm.stable:
        return ()
    if norm.reached <= norm.upper and norm.gap <= ROUTES_AGREE:
        return ()
    which = "is below" if norm.reached > norm.upper else "differs from"
    reached = f"the gain that a disturbance reaches, by {APART.cell(norm)} (relative)"
    return (f"the sampled norm {NORM_AS_IMPLEMENTED.cell(norm)} {which} {reached}",)


def instability_cured_by_sampling(vehicle: Vehicle, certificate: Certificate, norm: SampledNorm | None) -> tuple[str, ...]:
    """Returns the failures of the certificate that are ignored: instability of the continuous loop if the sampled-data loop is
    stable.

    If the vehicle file specifies an implementation, only the stability of the sampled-data loop counts, because this loop runs
    in the vehicle.
    """
    cured = norm is not None and norm.stable and not vehicle.implementation.undelayed
    return (certificate.stability.words,) if cured and not certificate.stable else ()


def failures_of_sampled_loop(
    vehicle: Vehicle, certificate: Certificate, failures: Iterable[str], norm: SampledNorm | None
) -> tuple[str, ...]:
    """Describes the failures of the sampled-data loop, and those failures of the continuous loop that still apply."""
    excused = instability_cured_by_sampling(vehicle, certificate, norm)
    return (*(failure for failure in failures if failure not in excused), *norm_failures(norm))


def notes_on_sampled_loop(vehicle: Vehicle, certificate: Certificate, norm: SampledNorm | None) -> tuple[str, ...]:
    """Returns a note if the continuous loop is not stable, but the sampled-data loop is stable."""
    return tuple(f"without sampling the loop is {words}" for words in instability_cured_by_sampling(vehicle, certificate, norm))


def false_norm(
    record: Mapping[str, Any] | None, vehicle: Vehicle, norm_of_loop: Callable[[], SampledNorm | None]
) -> tuple[str, ...]:
    """Describes the false claims that a record makes about the norm of the sampled-data loop.

    Args:
        record: certificate to check; None if the controller has no certificate.
        vehicle: vehicle with the implementation of the controller.
        norm_of_loop: function that computes the norm (`norm_if_implemented`). The function is called only if the record claims
            a norm.
    """
    said = (record or {}).get(SAMPLED_NORM)
    if said is None:
        return ()
    norm = norm_of_loop()
    if norm is not None and abs(norm.value - said) <= SAME * said:
        return ()
    claimed = f"the certificate claims that the sampled norm is {NORM_AS_IMPLEMENTED.digits(said)}"
    if norm is None:
        without = "[implementation] has neither sample_period nor delay"
        return (f"{claimed}, but {without if vehicle.implementation.undelayed else 'this loop has no finite norm'}",)
    off = f" ({APART.digits(abs(norm.value / said - 1))} off)" if norm.stable else ""
    return (f"{claimed}, but it is {NORM_AS_IMPLEMENTED.cell(norm)}{off} with {built_words(vehicle)}",)


def remarks_on_sampled_loop(vehicle: Vehicle, certificate: Certificate, norm: SampledNorm) -> tuple[str, ...]:
    """Returns the notes on a sampled-data loop and the failures that apply to it, without those of its lower bound."""
    failures = failures_of_sampled_loop(vehicle, certificate, certificate.loop_failures, norm)
    return (*notes_on_sampled_loop(vehicle, certificate, norm), *failures)
