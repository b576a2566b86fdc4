"""The norm of a loop as it is implemented, among what is claimed of a controller: in words, in records, and held against them."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from models.common.numbers import finite, percent
from models.controllers import IDEAL
from models.reality import USUAL_TIMESTEP, Limits
from models.vehicle import Vehicle
from synth.certificate.certificate import Certificate
from synth.certificate.record import SAMPLED_NORM
from synth.controller import Controller
from synth.implemented.norm import norm_as_implemented
from synth.sampled.norm import ABOVE, SampledNorm

SAME = 10 * ABOVE  # relative: two machines agree in a norm that lies between two levels so close
ROUTES_AGREE = 1e-6  # relative: a norm, and what an actual disturbance reaches of it


def norm_if_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm | None:
    """The norm of a loop as it is implemented, where `[implementation]` says of its computer how often or how late it acts."""
    return None if vehicle.implementation.prompt else norm_as_implemented(vehicle, controller, timestep)


def norm_record(norm: SampledNorm | None) -> dict[str, float]:
    """The norm as certificates hold it; empty where there is none, or it is infinite."""
    return {SAMPLED_NORM: norm.value} if norm is not None and norm.stable else {}


def norm_object(norm: SampledNorm | None) -> dict[str, Any]:
    """The norm as JSON has it, with what proves it; empty where there is none."""
    if norm is None:
        return {}
    return {SAMPLED_NORM: finite(norm.value), f"{SAMPLED_NORM}_proof": proof_object(norm) if norm.stable else None}


def proof_object(norm: SampledNorm) -> dict[str, Any]:
    """What proves a norm that is not infinite, as JSON has it."""
    return {
        "above": norm.lower,
        "below": norm.upper,
        "reached": norm.reached,
        "angle": finite(norm.angle),
        "decided_within_a_period": norm.inside,
        "by_sweep": norm.by_sweep,
    }


def norm_lines(vehicle: Vehicle, controller: Controller, norm: SampledNorm | None) -> list[str]:
    """The norm in words, beside that of the ideal loop; nothing where there is none."""
    if norm is None:
        return []
    built = built_words(vehicle)
    if not norm.stable:
        return [f"sampled norm infinite: UNSTABLE with {built}"]
    ideal = controller.certificate.norm.value
    # With its noise that norm is of another w, and with its lag of another z, which weighs the force asked for.
    alike = math.isfinite(ideal) and ideal and controller.hardware == IDEAL
    more = f", {against(norm.value, ideal)} the ideal loop's" if alike else ""
    seen = "frequencies" if norm.by_sweep else "level sets"
    lines = [
        f"sampled norm {norm.value:.7g}{more}: {built}, while road and car go on",
        f"it is less than {norm.upper:.9g} by {seen}, and a road reaches {norm.reached:.9g} of it",
    ]
    if norm.inside:
        lines.append("it is decided within one sample period: no controller at this rate has less")
    return lines


def built_words(vehicle: Vehicle) -> str:
    """What of a loop as built counts in its norm: what is linear of it."""
    lag = Limits(actuator_bandwidth=vehicle.limits.actuator_bandwidth)
    return ", ".join((*vehicle.implementation.clear.words, *lag.words(())))


def sampled_lines(vehicle: Vehicle) -> list[str]:
    """What "sampled" is in a table of norms, where there is such a column."""
    if vehicle.implementation.prompt:
        return []
    return [f"sampled is the norm of the loop as built, road and car going on between its samples: {built_words(vehicle)}"]


def norm_failures(norm: SampledNorm | None) -> tuple[str, ...]:
    """What does not hold of a norm, in words."""
    if norm is None or not norm.stable:
        return ()
    if norm.reached > norm.upper:
        return (f"the sampled norm is not less than {norm.upper:.12g}: a road reaches {norm.reached:.12g}",)
    if norm.gap <= ROUTES_AGREE:
        return ()
    return (f"the sampled norm {norm.value:.9g} and what a road reaches of it differ by {norm.gap:.0e}",)


def only_without_computer(vehicle: Vehicle, certificate: Certificate, norm: SampledNorm | None) -> tuple[str, ...]:
    """What of a certificate's failures is none, in words: that a loop would not be stable without the computer that makes it so.

    Whether a controller is any good is said by the loop that drives: the one that its computer closes, where there is one.
    """
    held = norm is not None and norm.stable and not vehicle.implementation.prompt
    return (certificate.stability.words,) if held and not certificate.stable else ()


def failures_as_it_runs(
    vehicle: Vehicle, certificate: Certificate, failures: Iterable[str], norm: SampledNorm | None
) -> tuple[str, ...]:
    """What fails of a controller as it runs, in words: of the failures without its computer, those that its computer leaves."""
    excused = only_without_computer(vehicle, certificate, norm)
    return (*(failure for failure in failures if failure not in excused), *norm_failures(norm))


def still_false(vehicle: Vehicle, controller: Controller, wrong: tuple[str, ...]) -> tuple[str, ...]:
    """What of a certificate's claims does not hold, in words, without what the computer of its loop makes good."""
    if not wrong or controller.certificate.stable:
        return wrong
    excused = only_without_computer(vehicle, controller.certificate, norm_if_implemented(vehicle, controller))
    return tuple(each for each in wrong if each not in excused)


def notes_as_it_runs(vehicle: Vehicle, certificate: Certificate, norm: SampledNorm | None) -> tuple[str, ...]:
    """What there is to know where only its computer makes a loop stable."""
    return tuple(f"without a computer its loop is {words}" for words in only_without_computer(vehicle, certificate, norm))


def against(value: float, other: float) -> str:
    """How far a value lies above or below another, in percent."""
    share = value / other - 1
    return "equal to" if abs(share) <= SAME else f"{percent(abs(share))} {'below' if share < 0 else 'above'}"


def false_norm(record: Mapping[str, Any] | None, vehicle: Vehicle, found: Callable[[], SampledNorm | None]) -> tuple[str, ...]:
    """What a record claims in vain of the norm as implemented, in words.

    Args:
        record: a certificate, whose numbers are numbers; None where a controller came without one.
        vehicle: it says how the controller is implemented.
        found: finds the norm (`norm_if_implemented`); it is called only where one is claimed.
    """
    said = (record or {}).get(SAMPLED_NORM)
    if said is None:
        return ()
    norm = found()
    if norm is not None and abs(norm.value - said) <= SAME * said:
        return ()
    claimed = f"the sampled norm is claimed to be {said:.10g}"
    if norm is None:
        return (f"{claimed}, and [implementation] has neither sample_period nor delay",)
    is_now = f"{norm.value:.10g}" if norm.stable else "infinite"
    return (f"{claimed}, and is {is_now} with {built_words(vehicle)}",)
