"""Texts about a controller and its design, and texts and JSON about its sampled-data loop."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from models import USUAL_TIMESTEP
from models.common.errors import InputError, list_names
from models.common.extensions import FEATURES
from models.common.printed import NORM_DIGITS, as_name, entry, percent, rough
from models.document.field import OMITTED_KEY, Field, Record
from models.kinds.signals import load_signal
from models.laws.linear import LinearLaw, gain_text
from models.vehicle.controllers import NOMINAL
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.analysis.specification import ABOVE, SAMPLED_NORM, SampledNorm
from synth.analysis.stability import MARGINAL
from synth.controller.controller import AnyController, Controller
from synth.controller.law_margins import law_margins
from synth.controller.problem import plant_states, road_twist_inputs

# allowed relative difference between the norms that two computers compute; a multiple of the distance between the levels that
# enclose the norm
SAME = 10 * ABOVE
ROUTES_AGREE = 1e-6  # largest allowed relative difference between a norm and the gain that an actual disturbance reaches


BOUND = Field[Certificate]("bound", lambda one: one.bound, NORM_DIGITS, key="bound")
NORM = Field[Certificate]("norm", lambda one: one.norm.value, NORM_DIGITS, key="norm")
PEAK = Field[Certificate]("peak", lambda one: one.norm.peak_frequency, ".5g", 1 / (2 * math.pi), "peak_frequency", "Hz")
LOWER_BOUND = Field[Certificate]("lower bound", lambda one: one.lower_bound, NORM_DIGITS, key="lower_bound")
GAP = Field[Certificate]("above it", lambda one: one.gap, percent, key="gap")
SLOWEST_POLE = Field[Certificate]("slowest pole", lambda one: one.own.worst.real, ".4g", unit="1/s")
NORM_AS_IMPLEMENTED = Field[SampledNorm]("sampled", lambda one: one.value if one.stable else "UNSTABLE", NORM_DIGITS)
REACHED_GAIN = Field[SampledNorm]("reached by a road", lambda one: one.reached, NORM_DIGITS)
APART = Field[SampledNorm]("difference", lambda one: one.gap, ".0e")


def norm_if_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm | None:
    """Returns the norm of the sampled-data loop of a vehicle and a controller, if the vehicle file specifies an implementation.

    The result is None if `[implementation]` has neither sample period nor delay. The result is also None for a stable loop that
    has no norm. A norm is missing only for laws for theoretical study, if a constant road height affects z, or if the law
    measures the road's warp.
    """
    if vehicle.implementation.undelayed:
        return None
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


def norm_record(norm: SampledNorm | None) -> dict[str, float]:
    """Returns a norm in the format of certificates; the result is empty if the norm is None or infinite."""
    return {SAMPLED_NORM: norm.value} if norm is not None and norm.stable else {}


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
        return (f"{claimed}, but [implementation] has neither sample_period nor delay",)
    off = f" ({APART.digits(abs(norm.value / said - 1))} off)" if norm.stable else ""
    return (f"{claimed}, but it is {NORM_AS_IMPLEMENTED.cell(norm)}{off} with {built_words(vehicle)}",)


# a gain counts as within 1e-4 of its limit if it changes by less than this relative amount while mu decreases by the last
# factor of 100
SETTLED_CHANGE = 1e-2
SHORT = 1e-6  # the central path counts as completed if the relative gap in gamma is smaller than this


def law_text(law: LinearLaw) -> str:
    """Formats a law: a static law as its gain, any other law as its equations and, for a PI or PID law, its gains."""

    if not law.states:
        return f"gain {gain_text(law.D)}"
    return "; ".join(filter(None, (law.text, FEATURES.load("PID laws").pid_text(law))))


def named_gain(vehicle: Vehicle, controller: Controller) -> str:
    """Returns a static law as text with units and signals, or as a matrix if it has more than `MOST_ENTRIES` entries."""
    gain, forces = controller.law.D, vehicle.linear_model.inputs
    if controller.law.states or gain.size > MOST_ENTRIES or gain.shape != (len(forces), len(controller.measured)):
        return law_text(controller.law)
    units = [vehicle.kind.signal(name).unit for name in controller.measured]
    of = [unit.removesuffix("/s2").removesuffix("/s") for unit in units]
    rates = [
        "" if unit == "N" else f" N{' s2' * unit.endswith('/s2')}{' s' * unit.endswith('/s')}/{base}"
        for unit, base in zip(units, of, strict=True)
    ]
    rows = []
    for force, row in zip(forces, gain, strict=True):
        entries = [f"{entry(value)}{rate} {name}" for value, rate, name in zip(row, rates, controller.measured, strict=True)]
        rows.append(f"gain{f' of {force}' if len(forces) > 1 else ''}: {', '.join(entries)}")
    return "; ".join(rows)


MOST_ENTRIES = 8  # a gain with at most this many entries is printed with signals and units


def pid_line(controller: Controller) -> str:
    """Formats the gains of a designed PI or PID law in the syntax of a vehicle file; returns an empty text for other laws."""
    pid = FEATURES.load("PID laws")
    remarked = (remark.partition(pid.ITS_GAINS)[2].partition("; ")[0] for remark in controller.remarks)
    return next(filter(None, remarked), "") or pid.pid_text(controller.law)


def sign_note(controller: Controller) -> str:
    """Returns a note about the signs of the gains if a PI or PID law with a positive gain makes the loop unstable; else empty."""
    if controller.certificate.stable or not controller.law.states:
        return ""
    pid = FEATURES.load("PID laws")
    if not any(gains.get(name, 0.0) > 0 for gains in pid.pid_gains(controller.law) for name in pid.GAINS):
        return ""
    return "; a positive kp, ki or kd lifts the body, which increases an extension: give negative gains to oppose it"


def twist_lines(vehicle: Vehicle) -> list[str]:
    """Returns a note about road warp, which is a separate disturbance, if the warp affects the vehicle."""
    count, rate = len(road_twist_inputs(vehicle.linear_model)), rough(vehicle.linear_model.twist_rate)
    # If the body has a roll or pitch axis, its weight acts in proportion to the inclination of the road.
    axes = {"roll_centre_height_front": "roll", "roll_centre_height": "roll", "pitch_centre_height": "pitch"}
    felt = [way for parameter, way in axes.items() if parameter in vehicle.parameters]
    felt += ["twist"] if count > len(felt) else []
    text = f"The disturbance w is the road's velocity under every wheel and the height of the road's {list_names(felt)}"
    return [f"{text}; 1 m of this height counts as {rate} m/s of road velocity."] if count else []


def ideal_lines(vehicle: Vehicle, controllers: Sequence[Controller]) -> list[str]:
    """If the vehicle file describes an implementation, returns notes that the printed numbers refer to the ideal loop."""
    names = [as_name(one.name) for one in controllers if one.hardware != NOMINAL]
    what = "noise, lag and loads" if any(one.hardware.loads for one in controllers) else "noise and lag"
    but = f", except for the {what} that {', '.join(names)} {'include' if len(names) > 1 else 'includes'}" if names else ""
    texts = [] if vehicle.ideal else [f"{OF} the ideal loop: continuous, without [limits] and [implementation]{but}."]
    if vehicle.dampers and any(one.law.acts for one in controllers):
        lag = ", and without the lag of their valves" if any(one.damper.bandwidth for one in vehicle.parts.adjustable) else ""
        texts.append(f"{OF} a loop whose semi-active dampers can supply every requested force{lag}.")
    return [*texts, *line_notes(vehicle)]


def line_notes(vehicle: Vehicle) -> list[str]:
    """Returns a note about the linearisation at equilibrium; empty for a linear vehicle."""
    if not vehicle.parts.with_curve:
        return []

    slopes = FEATURES.load("lines of parts").lines_at_rest(vehicle.parts.with_curve)
    return [f"{OF} the linearisation at equilibrium: {slopes}."] if slopes else []


OF = "Bound, norm and poles are those of"
IDLE_INTEGRAL = (
    "the integral of this law leaves a pole at 0 in the loop, so there is no finite norm: no constant force changes the "
    "integrated signal permanently, or no force uses the integral"
)
INTEGRATOR_POLE = 1e-9  # a pole belongs to an integrator if its relative distance from 0 is smaller than this


def _has_idle_integral(controller: Controller) -> bool:
    """Returns True if the law has a pole at 0 that remains a pole of the closed loop."""
    law, where = controller.law, controller.certificate.stability
    at_rest = 0.0 if law.sample_period is None else 1.0
    held = np.any(np.abs(np.linalg.eigvals(law.A) - at_rest) <= INTEGRATOR_POLE * (1 + np.abs(law.A).max(initial=0.0)))
    return bool(
        held and where.verdict == MARGINAL and np.any(where.rates[where.on_axis] <= INTEGRATOR_POLE * (1 + where.rates.max()))
    )


def growth_lines(vehicle: Vehicle, controller: Controller) -> list[str]:
    """Returns notes about a law: instability of the law itself, small margins of its loop, its integral and its anti-windup."""
    margins, rate = law_margins(vehicle, controller), controller.law.anti_windup
    winds = " and winds up when forces are clipped; anti_windup bounds its states" if margins.winds_up else ""
    notes = [f"this law is unstable by itself (a state grows at {rough(margins.growth)} 1/s){winds}"] if margins.growth else []
    notes += [margins.own_force] if margins.own_force else []
    notes += [f"WARNING: small {margins.small}"] if margins.small else []
    notes += [IDLE_INTEGRAL] if _has_idle_integral(controller) else []
    if rate is not None:
        follows = f"when forces are clipped, the states of the law follow the clipped forces at a rate of {rate:g} 1/s or faster"
        notes.append(f"anti-windup: {follows if controller.law.states else 'none, as this law has no states'}")
    return notes


# growth rate of the law itself, if the law is unstable [1/s]
GROWTH = Record[Controller](law_growth=lambda one: one.law.growth or OMITTED_KEY)


def filter_lines(vehicle: Vehicle) -> list[str]:
    """Returns notes about the filters in z and w, and about their poles; empty if there are no filters."""
    if not vehicle.filtered:
        return []
    texts = [f"{row.name} filtered by {row.filter.words}" for row in vehicle.weighted if row.filter is not None]
    texts += [f"w filtered by {vehicle.road_filter.words} to get the road's velocity"] if vehicle.road_filter is not None else []
    states = vehicle.road_filter is not None or any(name.startswith("filter_of_") for name in plant_states(vehicle))
    poles = "; the poles of these filters do not depend on control and are not listed" if states else ""
    lines = [f"norms include filters: {', '.join(texts)}{poles}"]
    if vehicle.integrals:
        names = list_names([name.removeprefix("integral_of_") for name in vehicle.integrals])
        lines.append(
            f"designs that measure {names} use the integral of each such signal as a state; norms of the sampled-data loop "
            "do not include integrals"
        )
    return lines


STUDY = "for study only: no sensor on a car measures heights over the datum of a flat road"


def study_notes(vehicle: Vehicle, controller: AnyController) -> list[str]:
    """Returns notes about a law for theoretical study: no car can measure the signals of this law, and a finite norm may not
    exist.
    """
    if not vehicle.linear_model.over_datum(controller.measured):
        return []
    shows = controller.problem(vehicle).judged(controller.law).unbounded_outputs if controller.linear is True else ()
    names = list_names([vehicle.weighted[i].name for i in shows])
    return [STUDY, *[f"no finite norm: a constant road height causes a constant {names}"] * bool(shows)]


FEEDBACK_ALONE = "norm, bound and poles are those of the feedback without the preview. The preview changes no pole and no margin"


def judged_lines(controller: Controller) -> list[str]:
    """Returns notes about noise, loads, lag, preview and a Tustin transform, if they are included in a controller's norm and
    bounds.
    """
    measured, hardware = controller.measured, controller.hardware
    noise = ", ".join(f"{rms:g} on {name}" for name, rms in zip(measured, hardware.noise, strict=bool(hardware.noise)) if rms)
    loads = ", ".join(f"{value:g} {load_signal(name).unit} of {name}" for name, value in hardware.loads)
    as_road = "as much as 1 m/s of unfiltered road velocity"
    texts = [FEEDBACK_ALONE] if controller.preview is not None else []
    texts += [f"norm and bounds include noise: an rms of {noise} counts {as_road}"] if noise else []
    if loads:
        omit = "norms of the sampled-data loop, and norms that `roadproof sweep` measures, do not include loads"
        texts.append(f"norm and bounds include loads: {loads} each count {as_road}; {omit}")
    if controller.law.states and controller.law.sample_period is not None:
        texts.append("the law is discrete: norm, bounds and poles are those of its continuous counterpart (Tustin's method)")
    if hardware.bandwidth is not None:
        lag = f"the actuators' lag, {hardware.bandwidth:g} rad/s"
        texts.append(f"norm, bounds and poles include {lag}; the force in z is the commanded force")
    return texts


def notes(controller: Controller) -> tuple[str, ...]:
    """Returns notes about the design of a controller: degenerate problem, fallback method, gap to the optimum, redundant
    measurements.
    """
    texts = [
        *judged_lines(controller),
        *(text for text in (controller.degeneracy, controller.fallback_method, *controller.remarks) if text),
    ]
    steps = controller.steps
    if steps is not None and steps.state_step_gap > SHORT:
        gap = percent(steps.state_step_gap)
        texts.append(f"designed from a state feedback {gap} above its optimum, because the optimum leads to no design")
    if steps is not None and steps.optimum_gap > SHORT:
        gap = percent(steps.optimum_gap)
        texts.append(f"the bound is {gap} above its optimum, which only gains that are too large for actuators reach")
    elif steps is not None and steps.moved > SETTLED_CHANGE:
        texts.append(
            f"the gain did not converge: the last step of the central path changed it by {percent(steps.moved)} of its "
            "largest entry, so the printed gain may not be optimal; norm and bound are those of the printed gain"
        )
    if controller.redundant:
        texts.append(f"redundant: {', '.join(controller.redundant)} is a combination of the other signals and has no gain")
    return tuple(texts)
