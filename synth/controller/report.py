"""Texts about a controller and its design."""

import math
from collections.abc import Sequence

from models import USUAL_TIMESTEP
from models.common.extensions import FEATURES
from models.common.printed import NORM_DIGITS, as_name, entry, percent, rough
from models.document.field import OMITTED_KEY, Field, Record
from models.kinds.signals import load_signal
from models.laws.linear import LinearLaw, gain_text
from models.vehicle.controllers import NOMINAL
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.analysis.specification import SAMPLED_NORM, SampledNorm
from synth.controller.controller import AnyController, Controller
from synth.controller.law_margins import law_margins

BOUND = Field[Certificate]("bound", lambda one: one.bound, NORM_DIGITS, key="bound")
NORM = Field[Certificate]("norm", lambda one: one.norm.value, NORM_DIGITS, key="norm")
PEAK = Field[Certificate]("peak", lambda one: one.norm.peak_frequency, ".5g", 1 / (2 * math.pi), "peak_frequency", "Hz")
LOWER_BOUND = Field[Certificate]("lower bound", lambda one: one.lower_bound, NORM_DIGITS, key="lower_bound")
GAP = Field[Certificate]("above it", lambda one: one.gap, percent, key="gap")
SLOWEST_POLE = Field[Certificate]("slowest pole", lambda one: one.own.worst.real, ".4g", unit="1/s")


def norm_if_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm | None:
    """Returns the norm of the sampled-data loop of a vehicle and a controller, if the vehicle file specifies an implementation.

    The result is None if `[implementation]` has neither sample period nor delay. The result is also None for a stable loop that
    has no norm. A norm is missing only for laws for theoretical study, if a constant road height affects z, or if the law
    measures the road's warp.
    """
    if vehicle.implementation.undelayed:
        return None
    return FEATURES.load("norms of sampled loops").norm_of_sampled_loop(vehicle, controller, timestep)


def norm_record(norm: SampledNorm | None) -> dict[str, float]:
    """Returns a norm in the format of certificates; the result is empty if the norm is None or infinite."""
    return {SAMPLED_NORM: norm.value} if norm is not None and norm.stable else {}


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


def growth_lines(vehicle: Vehicle, controller: Controller) -> list[str]:
    """Returns notes about a law: instability of the law itself, small margins of its loop, its integral and its anti-windup."""
    margins, rate = law_margins(vehicle, controller), controller.law.anti_windup
    winds = " and winds up when forces are clipped; anti_windup bounds its states" if margins.winds_up else ""
    notes = [f"this law is unstable by itself (a state grows at {rough(margins.growth)} 1/s){winds}"] if margins.growth else []
    notes += [margins.own_force] if margins.own_force else []
    notes += [f"WARNING: small {margins.small}"] if margins.small else []
    notes += FEATURES.load("integral action").notes_on_integral(controller) if controller.law.states else []
    if rate is not None:
        follows = f"when forces are clipped, the states of the law follow the clipped forces at a rate of {rate:g} 1/s or faster"
        notes.append(f"anti-windup: {follows if controller.law.states else 'none, as this law has no states'}")
    return notes


# growth rate of the law itself, if the law is unstable [1/s]
GROWTH = Record[Controller](law_growth=lambda one: one.law.growth or OMITTED_KEY)


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


def filter_lines(vehicle: Vehicle) -> list[str]:
    """Returns notes about the filters in z and w, and about their poles; empty if there are no filters."""
    return FEATURES.load("filters in plants").filter_lines(vehicle) if vehicle.filtered else []


def study_notes(vehicle: Vehicle, controller: AnyController) -> list[str]:
    """Returns notes about a law for theoretical study; see `measured_heights.study_notes`. Empty for laws of a car."""
    over_datum = vehicle.linear_model.over_datum(controller.measured)
    return FEATURES.load("measured heights").study_notes(vehicle, controller) if over_datum else []
