"""Results of a sweep compared with the claims of a controller: text and JSON."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import finite, finite_pairs, table, wrapped
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import at_rest
from sim.runs.agreement import COARSEST, SLACK
from sim.studies.frequency.describing_function import (
    DescribingFunction,
    describing_failures,
    describing_lines,
    describing_object,
    describing_verdict,
)
from sim.studies.frequency.eusama import MinimumLoad, load_failures, load_lines, load_object, minimum_loads
from sim.studies.frequency.identification import Lines, difference, ideal_measurements, identify
from sim.studies.frequency.worst_case_gain import Extremes, WorstRoad, extremes, worst_roads
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller, code_of
from synth.controller.report import judged_lines, norm_if_implemented

LINES, EXTREMES, OWN = "frequency responses", "norms", "laws in Python"
# Beside RK4's own error, which is known:
TOLERANCE = 1e-4  # of the response at a line: what turning makes of higher roads; on those of 0.1 mm 3e-7 is left
SMALLER, LEAST_AMPLITUDE = 0.1, 1e-6  # share of the road's height, and least height [m], at which turning is told from error
ABOVE = 1e-5  # above the norm, relative: free motion that is left when a gain is read
REACHED = 1e-3  # below the norm
DRIVEN = 1e-4  # above it, of its worst road, whose steps are shorter: 3e-5 is found


@dataclass(frozen=True, eq=False)
class Sweep:
    """Results of one controller: its frequency response, and its largest gains."""

    lines: Lines
    extremes: Extremes
    sampled: SampledNorm | None  # of the loop as implemented, exact; None without [implementation], or if the road is known
    road: WorstRoad | None  # the one that reaches it; None where there is none such
    loads: tuple[MinimumLoad, ...]  # by wheel, on EUSAMA's plate
    without: str  # what the vehicle file has of noise and quantisation, and these runs had not, in words; empty for neither
    small: Lines | None = None  # over roads of `SMALLER` of the height, if lines are off and the vehicle turns

    @property
    def controller(self) -> Controller:
        """Returns the controller."""
        return self.lines.controller

    @property
    def omega(self) -> Array:
        """Returns the frequencies of the lines [rad/s], shape (F,)."""
        return self.lines.omega

    @property
    def worst_omega(self) -> float:
        """The worst sinusoid that was driven [rad/s]."""
        return self.extremes.tried

    @property
    def ended(self) -> tuple[str, ...]:
        """Returns the ends of the linear regime in any of the runs."""
        on_road = self.road.ended if self.road is not None else ()
        return tuple(dict.fromkeys((*self.lines.ended, *self.extremes.ended, *on_road)))

    @property
    def gains(self) -> dict[str, float]:
        """L2 gain by road."""
        return {**self.extremes.gains, **({} if self.lines.gain is None else {"chirp": self.lines.gain})}


def sweep(
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    amplitude: float,
    timestep: float,
    speed: float,
    progress: Callable[[str], None] = lambda text: None,
) -> list[Sweep]:
    """Returns the sweep of every controller. `progress` is called with each of two stages, `LINES` and `EXTREMES`.

    Other arguments and errors as for `sim.studies.frequency.identification.identify`.
    """
    progress(LINES)
    near = at_rest(vehicle)
    lines = identify(near, controllers, amplitude, timestep, speed)
    progress(EXTREMES)
    most = extremes(near, controllers, amplitude, timestep, speed)
    loads = minimum_loads(vehicle.with_ideal_actuators, controllers, timestep)
    off = [line.controller for line in lines if _off(line)[0] > _off(line)[1] and not line.ended]
    small: dict[str, Lines] = {}
    if off and amplitude * SMALLER >= LEAST_AMPLITUDE and has_geometry(near):
        small = {line.controller.name: line for line in identify(near, off, amplitude * SMALLER, timestep, speed)}
    ideal = ideal_measurements(near)
    norms = [
        None if one.preview is not None or _reads_road(ideal, one) else norm_if_implemented(ideal, one.quiet, timestep)
        for one in controllers
    ]
    roads, noise = worst_roads(ideal, controllers, norms, amplitude, timestep), vehicle.implementation.noise_text
    return [
        Sweep(line, extreme, norm, road, load, noise, small.get(line.controller.name))
        for line, extreme, norm, road, load in zip(lines, most, norms, roads, loads, strict=True)
    ]


def _reads_road(vehicle: Vehicle, controller: Controller) -> bool:
    """Returns True if a reading contains the road's velocity: a mean over a timestep here, over a period in the sampled norm."""
    model = vehicle.linear_model
    return bool(np.any(model.Dw[[model.outputs.index(name) for name in controller.measured]]))


def _off(lines: Lines) -> tuple[float, float, str, bool]:
    """Returns the worst difference of a line from the sampled response, what is allowed of it, its signal, and whether the
    timestep is too coarse for it.
    """
    off = difference(lines.measured, lines.sampled, lines.units)
    integrator = SLACK * difference(lines.integrated, lines.sampled, lines.units)
    allowed = np.minimum(integrator, COARSEST) + TOLERANCE
    at = np.unravel_index(np.argmax(off / allowed), off.shape)
    return float(off[at]), float(allowed[at]), lines.outputs[at[1]], bool(integrator[at] > COARSEST)


def failures(one: Sweep | DescribingFunction) -> list[str]:
    """The claims that do not hold of a sweep, in words; of a law in Python, of which none is made, that nothing is known."""
    if isinstance(one, DescribingFunction):
        return describing_failures(one)
    why = f"; rounding to {_rounds(one)} is not in that: give a larger --amplitude" if _rounds(one) else ""
    return [text + why for text in _failures(one)]


def _rounds(one: Sweep) -> str:
    """Returns the numbers of exported code that has fixed point; empty without such code."""
    code = code_of(one.controller)
    return code.law.numbers if code is not None and code.law.fixed is not None else ""


def _failures(one: Sweep) -> list[str]:
    """The claims that do not hold of a linear law, in words."""
    failed, lines, norm = [], one.lines, one.extremes.worst.gain
    # What turning makes of a line goes with the road's height.
    off, allowed, signal, coarse = _off(lines if one.small is None else one.small)
    if not off <= allowed:
        why = "; the timestep is too coarse, give a smaller one" if coarse and not _rounds(one) else ""
        failed.append(f"a line of {signal} is {off:.2e} off the sampled response; {allowed:.2e} is allowed{why}")
    for invariant in one.extremes.invariants:
        if not invariant.error <= invariant.allowed:
            failed.append(f"{invariant.name} is {invariant.error:.1e} off its invariant; {invariant.allowed:.1e} is allowed")
    failed += _road_failures(one) + load_failures(one.loads)
    own = min(SLACK * abs(one.extremes.integrated - norm), COARSEST * norm)
    if not one.extremes.lti:
        most, (predicted, finer) = np.inf if one.sampled is None else one.sampled.value, one.extremes.predicted
        worst, allowed = one.gains["worst sinusoid"], most * (1 + ABOVE) + own + SLACK * abs(predicted - finer)
        if not abs(worst - predicted) <= ABOVE * predicted + own:
            failed.append(f"the worst sinusoid has an L2 gain of {worst:.7g}; {predicted:.7g} is predicted at this timestep")
        above = [(name, gain) for name, gain in one.gains.items() if not gain <= allowed]
        return failed + [f"the {name} has an L2 gain of {gain:.7g}, above the norm {most:.7g}" for name, gain in above]
    for name, gain in one.gains.items():
        if not gain <= norm * (1 + ABOVE) + own:
            failed.append(f"the {name} has an L2 gain of {gain:.7g}, above the held-road norm {norm:.7g}")
    if not one.gains["worst sinusoid"] >= norm * (1 - REACHED) - own:
        failed.append(f"the worst sinusoid reaches {one.gains['worst sinusoid']:.7g} of the held-road norm {norm:.7g} only")
    return failed


def holds(one: Sweep | DescribingFunction) -> bool:
    """Returns True if every claim holds within the linear regime, and a run was measured."""
    return not failures(one) or (isinstance(one, Sweep) and bool(one.ended))


def _road_failures(one: Sweep) -> list[str]:
    """The claims that do not hold of the worst road of a sampled loop."""
    if one.road is None or one.sampled is None:
        return []
    failure, gain, norm = f"the worst road has an L2 gain of {one.road.gain:.7g}", one.road.gain, one.sampled.value
    failed = [] if abs(gain - one.road.predicted) <= ABOVE * gain else [f"{failure}; {one.road.predicted:.7g} is predicted"]
    step = SLACK * abs(one.road.predicted - one.road.finer)  # energies between leaps are exact to the square of the timestep
    if not gain <= norm * (1 + DRIVEN) + step:
        failed.append(f"{failure}, above the norm {norm:.7g} of the sampled loop")
    if not one.road.twisted and not gain >= norm * (1 - REACHED) - step:
        failed.append(f"{failure} only; the norm of the sampled loop is {norm:.7g}")
    return failed


def _road_lines(one: Sweep) -> list[str]:
    """The worst road of a sampled loop, in words and numbers."""
    if one.sampled is None:
        return []
    if one.road is None:
        return [
            f"  norm of the sampled loop: {one.sampled.value:.7g}, decided within one sample, where no periodic road is worst"
        ]
    share, norm = one.road.gain / one.sampled.value, one.sampled.value
    twisted = "; that is of twists of the road beside its velocity, too" if one.road.twisted else ""
    return [
        f"  worst road of the sampled loop: gain {one.road.gain:.7g}, norm {norm:.7g} ({100 * share:.4f} %), in steps of "
        f"{1e3 * one.road.timestep:.4g} ms{twisted}"
    ]


def sweep_lines(one: Sweep | DescribingFunction) -> list[str]:
    """A sweep in words and numbers."""
    if isinstance(one, DescribingFunction):
        return describing_lines(one)
    norm, failed, lines_of_loop = one.extremes.worst, failures(one), one.lines
    sampled, continuous = lines_of_loop.error(lines_of_loop.sampled), lines_of_loop.error(lines_of_loop.continuous)
    errors = zip(lines_of_loop.outputs, sampled.tolist(), continuous.tolist(), strict=True)
    rows = [(name, f"{a:.1e}", f"{b:.1e}") for name, a, b in errors]
    lines = [f"controller {lines_of_loop.controller.name}"]
    if one.without:
        lines.append(f"  its loop as built, but without its {one.without}: no frequency response knows of such")
    lines += table([("largest relative error over the lines:", "to sampled", "to continuous"), *rows])
    if math.isfinite(lines_of_loop.order):
        lines.append(f"  sampled tends to continuous with the timestep to the power {lines_of_loop.order:.2f}")
    for invariant in one.extremes.invariants:
        lines.append(
            f"  |{invariant.name}| = {invariant.measured:.6f} at {invariant.omega:.2f} rad/s, {invariant.expected:.6f} for any "
            f"suspension ({invariant.error:.1e} off)"
        )
    lines.append(
        f"  held-road norm of the sampled loop, one road under all wheels: {norm.gain:.7g} at {norm.omega:.5g} rad/s; norm of "
        f"the continuous one, any road under any wheel: {_norm(one):.7g}"
    )
    lines += [f"  about the continuous norm: {text}" for text in judged_lines(lines_of_loop.controller)]
    gains = "".join(f", {name} {gain:.5g}" for name, gain in one.gains.items() if name != "worst sinusoid")
    worst = one.gains["worst sinusoid"]
    share = f"{100 * worst / norm.gain:.4f} % of the held-road norm"
    lines.append(f"  L2 gains in MuJoCo: worst sinusoid {worst:.7g} ({share}){gains}")
    if not one.extremes.lti and lines_of_loop.controller.law.acts:
        lines.append(
            "  the force is held over several timesteps, which adds other frequencies to a sinusoid; the held-road norm leaves "
            "them out"
        )
    lines += [*_road_lines(one), *load_lines(one.loads)]
    if failed and not one.ended:
        lines += [f"  DOES NOT AGREE: {text}" for text in failed]
    return lines


def short_lines(sweeps: Sequence[Sweep | DescribingFunction]) -> list[str]:
    """Returns a table of the norms, found in physics and in analysis, and how to see the rest."""
    rows: list[tuple[str, ...]] = [("", "held-road", "", "MuJoCo", "worst line", "continuous")]
    rows.append(("", "norm", "at rad/s", "reaches", "off sampled", "norm"))
    for one in sweeps:
        if isinstance(one, DescribingFunction):
            rows.append((one.controller.name, *("-",) * 5))
            continue
        norm, share = one.extremes.worst, one.gains["worst sinusoid"] / one.extremes.worst.gain
        off = max(one.lines.error(one.lines.sampled))
        numbers = (f"{norm.gain:.7g}", f"{norm.omega:.5g}", f"{100 * share:.4f} %", f"{off:.1e}", f"{_norm(one):.7g}")
        rows.append((one.controller.name, *numbers))
    told = [(one, failures(one)) for one in sweeps if not (isinstance(one, Sweep) and one.ended)]
    failed = []
    for one, texts in told:
        more = f"; and {len(texts) - 1} more, see -v" if len(texts) > 1 else ""
        failed += [f"  {one.controller.name} DOES NOT AGREE: {texts[0]}{more}"] if texts else []
    ahead = [one.controller.name for one in sweeps if isinstance(one, Sweep) and one.controller.preview is not None]
    alone = [f"  the continuous norm of {', '.join(ahead)} is of the feedback alone"] if ahead else []
    return [*table(rows), *alone, *failed, "  -v adds every signal, invariants, other roads and EUSAMA's least load"]


def summary_lines(sweeps: Sequence[Sweep | DescribingFunction]) -> list[str]:
    """The verdict on every sweep, a line each."""
    width = max(len(one.controller.name) for one in sweeps)
    return [line for one in sweeps for line in wrapped(_verdict(one), f"{one.controller.name:{width}}  ", 4)]


def _verdict(one: Sweep | DescribingFunction) -> str:
    """Returns the verdict of a sweep in a sentence."""
    if isinstance(one, DescribingFunction):
        return describing_verdict(one)
    if one.ended:
        return f"outside the linear regime: {', '.join(one.ended)}; what physics does there is shown, and is no disagreement"
    failed = failures(one)
    if failed:
        return f"DOES NOT AGREE in {len(failed)} claim{'s' * (len(failed) != 1)}"
    invariants = "the invariants, " if one.extremes.invariants else ""
    without = f" without its {one.without}" if one.without else ""
    norm = "the norm as the largest gain" if one.extremes.lti or one.road is not None else "nothing above the norm"
    return f"agrees{without}: every line, {invariants}and {norm}"


def sweep_object(one: Sweep | DescribingFunction) -> dict[str, Any]:
    """Returns a sweep as a JSON object: SI units, complex numbers as [real, imaginary], None for missing values."""
    if isinstance(one, DescribingFunction):
        return describing_object(one)
    lines, norm = one.lines, one.extremes.worst
    error = {"sampled": lines.error(lines.sampled), "continuous": lines.error(lines.continuous)}
    return {
        "controller": lines.controller.name,
        "without": one.without or None,
        "omega": lines.omega.tolist(),
        "signals": {
            name: {
                "measured": finite_pairs(lines.measured[:, i]),
                "sampled": finite_pairs(lines.sampled[:, i]),
                "continuous": finite_pairs(lines.continuous[:, i]),
                "error": {key: finite(value[i]) for key, value in error.items()},
            }
            for i, name in enumerate(lines.outputs)
        },
        "order": finite(lines.order),
        "invariants": [
            {"name": i.name, "omega": i.omega, "expected": i.expected, "measured": finite(i.measured)}
            for i in one.extremes.invariants
        ],
        "norm": {"sampled": norm.gain, "peak_frequency": norm.omega, "continuous": finite(_norm(one))},
        **_road_object(one),
        "minimum_load": load_object(one.loads),
        "gains": {name: finite(gain) for name, gain in one.gains.items()},
        "ended": list(one.ended),
        "failures": failures(one),
    }


def _road_object(one: Sweep) -> dict[str, Any]:
    """Returns the exact norm of a sampled loop and the road that reaches it; empty without such a loop."""
    if one.sampled is None:
        return {}
    road, measured = one.road, None
    if road is not None:
        measured = {"gain": finite(road.gain), "predicted": road.predicted, "angle": road.angle, "timestep": road.timestep}
    return {"sampled_norm": one.sampled.value, "worst_road": measured}


def _norm(one: Sweep) -> float:
    return one.lines.controller.certificate.norm.value
