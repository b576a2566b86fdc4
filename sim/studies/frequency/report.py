"""Printed documents about frequency responses, largest gains and minimum tyre loads."""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from models.common.printed import as_name, difference, percent
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, at_most
from models.document.reading import MANY
from models.document.text import join_words, names_text
from models.vehicle.limits_and_implementation import Limits, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import at_rest_words
from sim.observers.results import WHEN
from sim.studies.frequency.describing_function import STEADY, DescribingFunction, describing_failures
from sim.studies.frequency.eusama import DISPUTED_LIMIT, MinimumLoad
from sim.studies.frequency.figure import HERTZ, STEP
from sim.studies.frequency.identification import Lines
from sim.studies.frequency.sinusoids import HIGHEST, LOWEST
from sim.studies.frequency.sweep import GAIN, Sweep, failures
from sim.studies.frequency.worst_case_gain import MeasuredInvariant
from synth.controller.report import NORM, judged_lines

HZ = 1 / (2 * math.pi)  # hertz per rad/s
HEIGHT = Field[float]("height", lambda one: one, "g", 1e3, unit="mm")
SHARE = Field[float]("share of energy", lambda one: one, percent)
PEAK = Field[DescribingFunction]("largest gain", lambda one: np.nanmax(one.gains), ".5g")
RESPONSES: tuple[Field[Lines], ...] = (
    Field("controller", lambda one: one.controller.name),
    Field("error to sampled", lambda one: one.error(one.sampled).max(), difference),
    Field("to continuous", lambda one: one.error(one.continuous).max(), difference),
    Field("order of convergence", lambda one: one.order, ".2f", detail="full", column="order of the two"),
)
SIGNALS: tuple[Field[tuple[Lines, int]], ...] = (
    Field("controller", lambda of: of[0].controller.name),
    Field("signal", lambda of: of[0].outputs[of[1]].replace("_", " ")),
    Field("error to sampled", lambda of: of[0].error(of[0].sampled)[of[1]], difference),
    Field("to continuous", lambda of: of[0].error(of[0].continuous)[of[1]], difference),
)
GAINS: tuple[Field[Sweep], ...] = (
    Field("controller", lambda one: one.controller.name),
    Field("discrete-time norm", lambda one: one.extremes.worst.gain, GAIN.form, column="held-road norm"),
    Field("worst sinusoid", lambda one: one.gains["worst sinusoid"], "{:.6g}".format),
    Field(
        "share of norm",
        lambda one: one.gains["worst sinusoid"] / one.extremes.worst.gain,
        "{:.3f} %".format,
        100.0,
        column="of that norm",
    ),
    *(Field[Sweep](road, lambda one, road=road: one.gains.get(road), "{:.4g}".format) for road in ("bump", "chirp", "random")),
)
NORMS: tuple[Field[Sweep], ...] = (
    GAINS[0],
    Field("norm, continuous", lambda one: NORM.value(one.controller.certificate), NORM.form),
    Field("discrete-time norm at", lambda one: one.extremes.worst.omega, ".5g", HZ, unit="Hz", column="held-road norm at [Hz]"),
    Field("at", lambda one: one.extremes.worst.omega, ".5g", unit="rad/s", detail="full", column="held-road norm at [rad/s]"),
    Field("norm, sampled", lambda one: one.sampled and one.sampled.value, GAIN.form),
)
INVARIANTS: tuple[Field[tuple[str, MeasuredInvariant]], ...] = (
    Field("controller", lambda of: of[0]),
    Field("invariant", lambda of: f"|{of[1].name}|"),
    Field("frequency", lambda of: of[1].omega, ".2f", HZ, unit="Hz"),
    Field("angular frequency", lambda of: of[1].omega, ".2f", unit="rad/s", detail="full", column="frequency [rad/s]"),
    Field("for any suspension", lambda of: of[1].expected, ".6f"),
    Field("MuJoCo", lambda of: of[1].measured, ".6f"),
    Field("difference", lambda of: of[1].error, difference),
)
MOVING_PARTS: tuple[Field[tuple[DescribingFunction, int]], ...] = (
    Field("controller", lambda of: of[0].controller.name),
    Field("signal", lambda of: of[0].outputs[of[1]].replace("_", " ")),
    Field("unit", lambda of: f"{of[0].units[of[1]]} per m/s"),
    Field("fundamental", lambda of: np.nanmax(np.abs(of[0].measured[:, of[1]])), "{:.4g}".format),
    Field("at [Hz]", lambda of: of[0].omega[np.nanargmax(np.abs(of[0].measured[:, of[1]]))], "{:.3g}".format, HZ),
    Field("energy elsewhere", lambda of: np.nanmax(of[0].outside[:, of[1]]), percent),
    Field("most at [Hz]", lambda of: of[0].omega[np.nanargmax(of[0].outside[:, of[1]])], "{:.3g}".format, HZ),
)
LOADS: tuple[Field[tuple[str, MinimumLoad]], ...] = (
    Field("controller", lambda of: of[0]),
    Field("tyre", lambda of: of[1].tyre.replace("_", " ")),
    Field("least load, predicted", lambda of: of[1].ratio, ".2f", 100, unit="%"),
    Field("MuJoCo", lambda of: of[1].measured, ".2f", 100, unit="%"),
    Field("frequency", lambda of: of[1].omega, ".2f", HZ, unit="Hz"),
    Field("linear range ends with", lambda of: of[1].end or "-", column="linear regime ended by"),
)


def _if_bounded(get: Callable[[Sweep], float]) -> Callable[[Sweep], float | None]:
    return lambda one: get(one) if one.is_bounded else None


def _least_load(one: Sweep) -> MinimumLoad:
    return min(one.loads, key=lambda load: load.ratio)


SUMMARY: tuple[Field[Sweep], ...] = (
    GAINS[0],
    Field("error to sampled", lambda one: one.lines.error(one.lines.sampled).max(), difference),
    Field("norm, continuous", lambda one: NORM.value(one.controller.certificate) if one.is_bounded else None, NORM.form),
    Field("norm, discrete", _if_bounded(GAINS[1].value), GAIN.form),
    Field("at", _if_bounded(NORMS[2].value), ".5g", HZ, unit="Hz"),
    Field("share of it", _if_bounded(GAINS[3].value), ".2f", 100.0, unit="%"),
    Field("invariant error", lambda one: max((each.error for each in one.extremes.invariants), default=None), difference),
    Field("least load", lambda one: _least_load(one).measured, ".1f", 100.0, unit="%"),
)  # columns of `summarize` for linear controllers


def _if_steady(get: Callable[[DescribingFunction], float]) -> Callable[[DescribingFunction], float | None]:
    return lambda one: get(one) if np.isinf(one.diverged).any() else None


LAWS: tuple[Field[DescribingFunction], ...] = (
    Field("controller", lambda one: one.controller.name),
    PEAK.of(lambda one: one if np.isinf(one.diverged).any() else None),
    Field("at", _if_steady(lambda one: one.worst_omega), ".3g", HZ, unit="Hz"),
    Field("energy elsewhere", _if_steady(lambda one: float(np.nanmax(one.outside))), percent),
    Field("change in a period", lambda one: one.drift, percent),
    Field("runs diverged", lambda one: str(np.isfinite(one.diverged).sum())),
    Field("limits reached", lambda one: ", ".join(one.ended) or "-"),
)  # columns of `summarize` for nonlinear laws


def summarize(sweeps: Sequence[Sweep], own: Sequence[DescribingFunction]) -> Document:
    """Returns the document with a row for each controller: norms, the largest differences from linear analysis, and the
    smallest tyre load.
    """
    text = (
        "Norm, discrete: of the sampled loop, on roads that are constant during each timestep. Share: gain for the worst "
        "sinusoid in MuJoCo. Invariants: responses that no suspension changes. Least load: the smallest tyre load on a plate "
        f"that moves by 6 mm, in % of the static load (EUSAMA TS-02-76). This test is {DISPUTED_LIMIT}."
    )
    failed = [Statement(f"{as_name(one.controller.name)}: {each}.", "fails") for one in own for each in describing_failures(one)]
    tables = [Table.of("summary", text, SUMMARY, sweeps), *notes(text)] if sweeps else []
    laws = [Table.of("laws", "Sinusoidal roads with laws to which linear analysis does not apply.", LAWS, own)] if own else []
    return Document("Summary", (*failed, *tables, *laws))


def describe(
    vehicle: Vehicle,
    lines: Sequence[Lines],
    sweeps: Sequence[Sweep],
    own: Sequence[DescribingFunction],
    amplitude: float,
    timestep: float,
) -> Document:
    """Returns the document about the frequency responses and gains of all controllers.

    Args:
        vehicle: vehicle whose responses are described.
        lines: frequency responses of the linear controllers.
        sweeps: sweeps of the linear controllers; empty if only frequency responses were measured.
        own: describing functions of the nonlinear laws, if there are any.
        amplitude: largest height of the roads [m].
        timestep: timestep of the simulation [s].
    """
    text = [*_claims(lines, sweeps), *(each for one in own for each in _law_statements(one))]
    text += [*notes(*_method(vehicle, lines, amplitude, timestep)), *notes(*_about(vehicle, sweeps, timestep), detail="full")]
    tables = []
    if lines:
        tables.append(Table.of("frequency-responses", "Frequency responses in MuJoCo and in linear analysis.", RESPONSES, lines))
    if sweeps:
        bounded = [one for one in sweeps if one.is_bounded]
        tables += [Table.of("gains", "L2 gains from road to z in MuJoCo.", GAINS, bounded)] * bool(bounded)
        tables += _details(sweeps)
    if own:
        caption = "Describing functions: fundamental divided by road velocity, and share of energy at other frequencies."
        moving = [(one, i) for one in own for i in one.moving]
        detail = "normal" if len(moving) <= MANY else "full"
        tables.append(Table.of("describing-functions", caption, MOVING_PARTS, moving, 3, detail=detail))
    return Document("Frequency response", (*text, *tables))


def _claims(lines: Sequence[Lines], sweeps: Sequence[Sweep]) -> Iterator[Statement]:
    """Yields statements about the agreement with linear analysis: one for all controllers that agree, and one for each failed
    check.
    """
    of = {one.controller.name: one for one in sweeps}
    failed = {name: failures(one) for name, one in of.items() if not one.ended}
    holding: dict[str, list[Lines]] = {}
    for one in lines:
        if not (of.get(one.controller.name) or one).ended and not failed.get(one.controller.name):
            holding.setdefault(_largest(of.get(one.controller.name)), []).append(one)
    for largest, some in holding.items():
        off = at_most(max(float(one.error(one.sampled).max()) for one in some))
        names = names_text(one.controller.name for one in some)
        text = f"For {names}, every frequency response in MuJoCo is within {off} of the exact response of the sampled loop."
        small = [line for one in some if (sweep := of.get(one.controller.name)) and (line := sweep.small) is not None]
        if small:
            near = at_most(max(float(line.error(line.sampled).max()) for line in small))
            text += f" Over a lower road, where characteristics and angles matter less, the response is within {near}."
        yield Statement(f"{text} {largest}".rstrip(), "holds")
    for name, texts in failed.items():
        for i, text in enumerate(texts):
            yield Statement(f"{as_name(name)} DOES NOT AGREE: {text}.", "fails", "full" if i else "normal")
    for one in sweeps or lines:
        if one.ended:
            yield Statement(f"{as_name(one.controller.name)} left the linear regime: {join_words([*one.ended])}.", "ends")


def _largest(one: Sweep | None) -> str:
    """Returns a sentence about the gains of a sweep that passes all checks; empty if there was no sweep."""
    if one is None:
        return ""
    if not one.is_bounded:
        text = "No sinusoid is the worst, because the loop has no finite norm"
    elif one.extremes.lti:
        text = "The gain for the worst sinusoid equals the discrete-time norm, and no other road has a larger gain"
    elif one.sampled is None:
        text = "The worst sinusoid has the predicted gain"
    else:
        text = "No gain exceeds the norm of the sampled loop"
    return f"{text}; the invariant transfer functions hold." if one.extremes.invariants else f"{text}."


def _method(vehicle: Vehicle, lines: Sequence[Lines], amplitude: float, timestep: float) -> Iterator[str]:
    """Yields the notes that are always printed: how the responses were measured, and with which predictions they are compared."""
    how, limits = vehicle.implementation, Limits(actuator_bandwidth=vehicle.limits.actuator_bandwidth)
    lag, noise = limits.phrases(()), how.noise_text
    without = f", without {noise}, which {'have' if ' and ' in noise else 'has'} no frequency response" if noise else ""
    band, roads, steps = f"{LOWEST:g} to {HIGHEST:g} Hz", HEIGHT.text(amplitude), STEP.text(timestep)
    yield f"Responses were measured from {band}, with a road amplitude of {roads} and a timestep of {steps}{without}."
    if lines:
        held = how.without_noise.phrases or ("forces held over each timestep",)
        yield (
            f"'Sampled' is the exact response of the loop that MuJoCo simulates: {', '.join((*held, *lag))}. 'Continuous' is "
            "the "
            f"response of the continuous loop{', with ' * bool(lag)}{', '.join(lag)}."
        )
    if words := at_rest_words(vehicle):
        yield f"{words}, because only such a loop has a frequency response."


def _about(vehicle: Vehicle, sweeps: Sequence[Sweep], timestep: float) -> Iterator[str]:
    """Yields the notes about H-infinity norms and measured gains."""
    if not sweeps:
        return
    held = "The discrete-time norm is the norm of the sampled loop on roads that are constant during each timestep, as in MuJoCo."
    if steps_per_sample(vehicle.implementation, timestep) > 1:
        yield f"{held} This norm omits the frequencies that a force held over several timesteps adds, so a gain can be larger."
    else:
        yield f"{held} A road that moves during a timestep can have a larger gain."
    if len(vehicle.kind.wheels) > 1:
        yield "All wheels pass the same road here. The norms of the designs allow a different road under each wheel."
    yield from (f"{as_name(one.controller.name)}: {text}." for one in sweeps for text in judged_lines(one.controller))


def _details(sweeps: Sequence[Sweep]) -> Iterator[Table]:
    """Yields the tables that only `-v` prints."""
    signals = [(one.lines, i) for one in sweeps for i in range(len(one.lines.outputs))]
    invariants = [(one.controller.name, each) for one in sweeps for each in one.extremes.invariants]
    norms = NORMS if any(one.sampled for one in sweeps) else NORMS[:-1]
    yield Table.of("signals", "Largest errors of the frequency responses of each signal.", SIGNALS, signals, 2, detail="full")
    bounded = [one for one in sweeps if one.is_bounded]
    yield Table.of("sampled-norms", "Norms of the continuous and of the sampled loop.", norms, bounded, detail="full")
    if invariants:
        caption = "Transmissibilities from the road that no suspension force can change."
        yield Table.of("invariants", caption, INVARIANTS, invariants, 2, detail="full")


def _law_statements(one: DescribingFunction) -> Iterator[Statement]:
    """Yields statements about a nonlinear law: its largest gain, and the runs in which nothing was measured."""
    name, count, wild = as_name(one.controller.name), len(one.omega), np.isfinite(one.diverged)
    yield from (Statement(f"{name}: {text}.", "fails") for text in describing_failures(one))
    text = f"Linear analysis does not apply to {name}, {one.controller.kind}. Instead, {count} sinusoidal roads were simulated."
    if not wild.all():
        largest = f"{PEAK.cell(one)} at {HERTZ.text(HZ * one.worst_omega)}"
        outside = SHARE.text(float(np.nanmax(one.outside)))
        text += f" The largest gain is {largest}. At most {outside} of a signal's energy is not at the road's frequency."
    yield Statement(text)
    for which, how in (
        (wild & ~one.law_diverged, "diverged"),
        (one.law_diverged, "stopped, because the states of the law overflowed"),
    ):
        if which.any() and not wild.all():
            first = WHEN.text(float(np.min(one.diverged[which])))
            yield Statement(
                f"{name}: {np.sum(which)} of {count} runs {how}, the first at {first}. The results do not contain these runs."
            )
    if one.ended:
        yield Statement(f"{name} left the linear regime: {join_words([*one.ended])}.")
    if one.drift > STEADY:
        drift, period = SHARE.text(one.drift), HERTZ.text(HZ * one.omega[0])
        yield Statement(
            f"The run with {name} has not settled: the fundamental of a signal changed by {drift} in one period of {period}."
        )
    yield Statement(f"On other roads, or at other heights, the describing function of {name} can differ.", detail="full")


def workshop(vehicle: Vehicle, sweeps: Sequence[Sweep]) -> Document:
    """Returns the document about the EUSAMA test: the minimum load of each wheel with each controller."""
    text = [
        "A plate under one wheel at a time moves by 6 mm, at up to 25 Hz. The grade is the smallest tyre load, in % of the "
        f"static load (EUSAMA TS-02-76). This test is {DISPUTED_LIMIT}."
    ]
    text += [f"{words}."] if (words := at_rest_words(vehicle)) else []
    loads = [(one.controller.name, load) for one in sweeps for load in one.loads]
    table = Table.of("eusama", "Smallest tyre load of each wheel on the plate, in % of the static load.", LOADS, loads, 2)
    return Document("Workshop test (EUSAMA)", (*notes(*text), table))
