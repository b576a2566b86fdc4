"""Margins of the loop that exported code closes, predicted with its numbers and with ideal ones, and found in MuJoCo.

The code drives the runs, with its own sample period, delay and rounding. A factor or a delay of whole timesteps is put between
its forces and the actuators. Readings in coarse steps need a bump that is not lost in them, and show an edge less sharply.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.printed import finite, table
from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear.rounding import rounding_effect
from sim.linear.sampled_response import sampled_response
from sim.response.response import Response
from sim.runs.run import sample_times
from sim.studies.stability.bisection import GAIN_WIDTH, Bisection, run_searches
from sim.studies.stability.growth_test import BUMP, GONE, Trial, no_progress
from synth.controller.controller import Controller
from synth.controller.export.compiled import BehindCode, CompiledController, ExportedCode, with_behind
from synth.controller.open_loop import LoopModel
from synth.controller.sampled_margins import SampledMargins, sampled_margins
from synth.vehicle.exported_numbers import (
    CHANGE,
    MARGINS,
    numbers_lines,
    numbers_notes,
    numbers_object,
    numbers_rows,
    with_numbers,
)

AMPLE, LATEST = 32.0, 1.0  # the largest factor that is tried where any is predicted, and the longest delay [s]
HIGHEST = 0.01  # m, of a bump that lifts no wheel
SHARE = 0.25  # of a range or limit, that the bump takes
FINE, HIDDEN = (
    1e-6,
    0.02,
)  # share of a signal that rounding moves it by, up to which it is not seen, and from which nothing else is
FAINT = 2.0  # times that share, what is left of a signal is rounding
COARSE = 0.05  # relative; how closely an edge is looked for where readings have steps
AGREES = 5e-3  # relative, of a factor


@dataclass(frozen=True, eq=False)
class ExportedMargins:
    """Margins of one loop with exported code.

    Attributes:
        about: norm, margins and specifications with ideal numbers and with those of the code, see `numbers_object`.
        predicted: margins with the numbers of the code.
        gain, lower, delay: the searches; `lower` is for the inverse of a factor below 1.
        timestep: timestep of the physics [s].
        hidden: True if rounding hides motion that grows or decays: then nothing is searched.
    """

    about: Mapping[str, Any]
    predicted: SampledMargins
    gain: Bisection
    lower: Bisection
    delay: Bisection
    timestep: float
    hidden: bool

    @property
    def _delay(self) -> float:
        return self.predicted.delay if self.predicted.delay < LATEST else math.inf

    @property
    def _lost(self) -> float:
        """The delay with which runs grow; where it is looked for in coarse steps, the middle of the step that has it."""
        return self.delay.unstable if self.gain.width == GAIN_WIDTH else (self.delay.stable + self.delay.unstable) / 2

    @property
    def digits(self) -> str:
        """Format of the values found."""
        return ".6g" if self.gain.width == GAIN_WIDTH else ".3g"

    @property
    def agrees(self) -> bool:
        """Returns True if MuJoCo has every margin: a factor to 0.5 %, a delay to a timestep, or as near as was looked."""
        if self.hidden:
            return True
        inverse = 1 / self.predicted.gain_lower if self.predicted.gain_lower else math.inf
        within = max(AGREES, self.gain.width)
        return (
            _close(self.predicted.gain, self.gain.found, within * self.gain.found)
            and _close(inverse, self.lower.found, within * self.lower.found)
            and _close(self._delay, self.delay.unstable, self.delay.step)
        )

    @property
    def record(self) -> dict[str, Any]:
        """Returns the margins as a JSON object: the content of `numbers_object`, and MuJoCo's results."""
        mujoco = None
        if not self.hidden:
            mujoco = {
                "gain": finite(self.gain.found),
                "gain_lower": None if math.isinf(self.lower.found) else 1 / self.lower.found,
                "phase": finite(self._lost * self.predicted.frequency),
                "delay": finite(self._lost),
            }
        return {**self.about, "mujoco": mujoco, "agrees": self.agrees}

    @property
    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """Returns the rows of a table: those of `numbers_rows`, and what MuJoCo found."""
        found, rows = self.record["mujoco"] or {}, []
        seen = {name: found[key] and scale * found[key] for key, (name, scale) in MARGINS.items() if key in found}
        alone = {name for key, (name, _) in MARGINS.items() if found and key not in found}  # a lead: no run can show it
        for row in numbers_rows(self.about):
            value = seen.get(row[0])
            unseen = "-" if row[0] in alone else ""
            rows.append((*row, unseen if row[0] not in seen else "any" if value is None else f"{value:{self.digits}}"))
        return rows

    @property
    def verdict(self) -> str:
        """Returns the verdict in words."""
        if self.hidden:
            return "not run: rounding in these numbers hides what decays and what grows"
        return "agrees" if self.agrees else "DOES NOT AGREE; where the timestep is too coarse, give a smaller one"

    def lines(self, full: bool) -> list[str]:
        """Returns the table with its sentences; not in full, the rows that MuJoCo has."""
        head = ("with the exported code", *self.about["loops"], CHANGE, "MuJoCo")
        near = f"  MuJoCo: the middle of steps of {COARSE:.0%}, as readings have steps, too"
        looked = [near] if self.gain.width != GAIN_WIDTH and not self.hidden else []
        if full:
            return [*table([head, *self.rows]), *numbers_notes(self.about), *looked, f"  {self.verdict}"]
        rows = [row for row in self.rows if row[4]]
        return [*(table([head, *rows]) if rows else numbers_lines(self.about, full)), *looked, f"  {self.verdict}"]


def _close(predicted: float, found: float, within: float) -> bool:
    return predicted == found or (math.isfinite(predicted) and abs(predicted - found) <= within)


def find_exported_margins(
    vehicle: Vehicle, controller: CompiledController, timestep: float, progress: Callable[[str], None] = no_progress
) -> ExportedMargins:
    """Returns the margins of the loop that exported code closes, for all forces together.

    Args:
        vehicle: vehicle with force actuators and its implementation.
        controller: controller driven by its code.
        timestep: MuJoCo's timestep [s]; sample period and delay are multiples of it.

    Raises:
        InputError: the code sets adjustable dampers, or the loop with these numbers is not stable.
    """
    code = controller.code
    assert code is not None, "it is driven by its code"
    if code.law.dampers:
        raise InputError("margins of exported code are of forces, and its adjustable dampers get coefficients; leave out --as")
    about = numbers_object(vehicle, controller, code.law, timestep)
    judged = with_numbers(vehicle, controller, code.law)
    predicted = sampled_margins(vehicle, judged, timestep)
    if predicted is None:
        raise InputError(f"controller {controller.name!r} is not stable with the numbers of its code; export it in finer ones")
    how = replace(vehicle, implementation=vehicle.implementation.without_noise)
    blur = _blur(how, judged, code, timestep)
    period = how.implementation.sample_period or timestep

    def trial(factor: float, steps: int) -> Trial:
        late = replace(how.implementation, delay=how.implementation.delay + steps * timestep / period)
        driven = with_behind(replace(judged, law=judged.law.scaled(factor)), code, BehindCode(factor, steps))
        return Trial(replace(how, implementation=late), driven, None, blur.height, max(GONE, (FAINT * blur.share) ** 2))

    width = COARSE if blur.coarse else GAIN_WIDTH
    inverse = 1 / predicted.gain_lower if predicted.gain_lower else math.inf
    delay = predicted.delay if predicted.delay < LATEST else math.inf
    step = timestep * (max(1, round(COARSE * delay / timestep)) if blur.coarse and math.isfinite(delay) else 1)
    found = ExportedMargins(
        about,
        predicted,
        Bisection(lambda amount: trial(amount, 0), predicted.gain, most=AMPLE, width=width),
        Bisection(lambda amount: trial(1 / amount, 0), inverse, most=AMPLE, width=width),
        Bisection(lambda amount: trial(1.0, round(amount / timestep)), delay, most=LATEST, step=step),
        timestep,
        blur.share > HIDDEN,
    )
    if not found.hidden:
        run_searches([found.gain, found.lower, found.delay], timestep, progress)
    return found


@dataclass(frozen=True)
class _Blur:
    """Bump, and how much of its motion rounding hides.

    Attributes:
        height: height of the bump [m].
        share: rms of the error of a signal over that of the signal, the largest of any.
        coarse: True if readings have steps that a run shows.
    """

    height: float
    share: float
    coarse: bool


def _blur(vehicle: Vehicle, controller: Controller, code: ExportedCode, timestep: float) -> _Blur:
    """Returns the bump for a code: tiny, or of numbers in steps as high as readings, limits and wheels allow."""
    law = code.law
    if law.fixed is None and not np.any(law.resolution):
        return _Blur(BUMP.height, 0.0, False)
    loop = LoopModel(vehicle, controller, timestep)
    response = sampled_response(loop, RoadInput(vehicle, BUMP, sample_times(vehicle, 1.0, timestep)))
    peaks = np.array([response.peak(name) for name in controller.measured])
    most = [] if law.ranges is None else (SHARE * law.ranges / peaks).tolist()
    most += [] if law.limit is None else [SHARE * law.limit / response.peak(name) for name in law.outputs]
    times = min(HIGHEST / BUMP.height, *most)
    higher = Response(response.time, response.signals, times * response.values)
    effect = rounding_effect(loop, law, higher)
    shares = [effect.rms[name] / higher.rms(name) for name in vehicle.linear_model.outputs if higher.rms(name) > 0]
    share = float(max(*shares, np.max(law.resolution / (math.sqrt(12) * times * peaks))))
    return _Blur(times * BUMP.height, share, bool(share > FINE))
