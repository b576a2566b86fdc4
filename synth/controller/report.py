"""What there is to say of a controller and its design: in words, and of its loop as it is implemented also in records."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from models import USUAL_TIMESTEP
from models.common.arrays import Array
from models.common.printed import finite, matrix, percent
from models.kinds.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD
from models.laws.linear import LinearLaw
from models.vehicle.controllers import IDEAL
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.analysis.record import SAMPLED_NORM
from synth.analysis.specification import ABOVE, SampledNorm
from synth.controller.controller import Controller

SAME = 10 * ABOVE  # relative: two machines agree in a norm that lies between two levels so close
ROUTES_AGREE = 1e-6  # relative: a norm, and what an actual disturbance reaches of it


def norm_if_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm | None:
    """The norm of a loop as it is implemented, where `[implementation]` says of its computer how often or how late it acts."""
    if vehicle.implementation.prompt:
        return None
    from synth.controller.implementation_norm import norm_as_implemented

    return norm_as_implemented(vehicle, controller, timestep)


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


IDEAL_LOOP = "of the ideal loop, continuous and without [limits] and [implementation]"
SETTLED = 1e-2  # relative: a gain that moves less over the last hundredfold of mu is within 1e-4 of the limit
SHORT = 1e-6  # relative in gamma; less is the path's own end
UNITS = {one.name: one.unit for one in (HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD)}


def heading_lines(controller: Controller) -> list[str]:
    """What a controller measures, and its gain."""
    measures = f"controller {controller.name}: measures {', '.join(controller.measured) or 'nothing'}"
    if not controller.measured:
        return [measures, "  no control force"]
    return [measures, *law_lines(controller.law, "  gain ", "  law ")]


def law_lines(law: LinearLaw, gain: str, of_states: str) -> list[str]:
    """A law after some text: a static one as its gain, a row to a line, others by their states and poles."""
    if not law.states:
        return gain_lines(law.D, gain)
    return [f"{of_states}{law.text}"]


def gain_lines(gain: Array, start: str) -> list[str]:
    """A gain matrix after some text, a row to a line."""
    return matrix(start, [[f"{entry:.6g}" for entry in row] for row in gain])


def twist_lines(vehicle: Vehicle) -> list[str]:
    """What else than the road's velocity a norm is of, where a road acts by its height, too."""
    model = vehicle.linear_model
    if not np.any(model.Br) and not np.any(model.Cr):
        return []
    return [
        "w is the road's velocity under every wheel and, as no car forgets it, the height of its twist, of which 1 m counts as "
        f"{model.twist_rate:.4g} m/s (models/README.md)"
    ]


def ideal_lines(vehicle: Vehicle, controllers: Sequence[Controller]) -> list[str]:
    """Which loop the numbers of these controllers are of, where the vehicle file has another one, too."""
    asked = [one.name for one in controllers if one.hardware != IDEAL]
    what = "noise, lag and loads" if any(one.hardware.loads for one in controllers) else "noise and lag"
    but = f", but for the {what} that {', '.join(asked)} {'ask' if len(asked) > 1 else 'asks'} for" if asked else ""
    found = [] if vehicle.ideal else [f"bound, norm and poles are {IDEAL_LOOP}{but}"]
    if vehicle.dampers and any(one.law.acts for one in controllers):
        lag = ", and know no lag of their valves" if any(one.damper.bandwidth for one in vehicle.adjustable) else ""
        found.append(
            f"bound, norm and poles are of forces that are given: they hold only while the adjustable dampers give them{lag}"
        )
    if vehicle.fitted:
        from models.suspension.fitted_curves import lines_at_rest

        slopes = lines_at_rest(vehicle.fitted)
        found += [f"bound, norm and poles are of the lines of [curves] at rest: {slopes}"] if slopes else []
    return found


def filter_lines(vehicle: Vehicle) -> list[str]:
    """What filters are in z and in w, where there are any, and whose poles theirs are."""
    if not vehicle.filtered:
        return []
    found = [f"{signal} through {one.words}" for signal, one in vehicle.filters.items()]
    found += [f"the road's velocity from w through {vehicle.road_filter.words}"] if vehicle.road_filter is not None else []
    return [f"norms are of {', '.join(found)}; their poles are in every loop, no control moves them, and they are left out"]


def judged_lines(controller: Controller) -> list[str]:
    """What a controller's norm and bounds are of, where that is more than its law on the vehicle."""
    measured, hardware = controller.measured, controller.hardware
    pairs = zip(measured, hardware.noise, strict=bool(hardware.noise))
    noise = ", ".join(f"{rms:g} on {name}" for name, rms in pairs if rms)
    found = []
    if noise:
        found.append(
            f"norm and bounds are of road and noise together: a noise of {noise} counts as much as 1 m/s of w, which is the "
            "road's velocity, or what its filter shapes it from"
        )
    if hardware.loads:
        loads = ", ".join(f"{value:g} {UNITS[name]} of {name}" for name, value in hardware.loads)
        found.append(
            f"norm and bounds are of road and loads together: {loads} count as much as 1 m/s of w each; a norm as implemented, "
            "and one that sim.sweep measures, is of the road alone"
        )
    if controller.law.states and controller.law.sample_period is not None:
        found.append("norm, bounds and poles are of its continuous counterpart, whose bilinear transform (Tustin) it is")
    if hardware.bandwidth is not None:
        found.append(
            f"norm, bounds and poles are with the actuators' lag, {hardware.bandwidth:g} rad/s; the force that z weighs is the "
            "one asked for"
        )
    return found


def notes(controller: Controller) -> tuple[str, ...]:
    """What is the case where there is no one optimum, what was done instead, how far from it a design is, what is in vain."""
    found = [*judged_lines(controller), *(text for text in (controller.case, controller.instead, *controller.remarks) if text)]
    if controller.state_step_gap > SHORT:
        gap = percent(controller.state_step_gap)
        found.append(f"from an X {gap} short of the best state feedback; from the best there is no design")
    if controller.optimum_gap > SHORT:
        gap = percent(controller.optimum_gap)
        found.append(f"bound {gap} short of the optimum, which only a gain beyond any actuator reaches")
    elif controller.moved > SETTLED:
        found.append(
            f"gain not settled: over the last step of its path it moved by {percent(controller.moved)} of its largest entry, so "
            "that its digits are not those of the optimum; the norm and its bound hold for it as it is"
        )
    if controller.redundant:
        found.append(f"measures in vain: {', '.join(controller.redundant)} follows from the other signals and is given no gain")
    return tuple(found)
