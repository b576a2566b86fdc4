"""Numbers of the gallery, computed here: exactly, and in MuJoCo where a run shows them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import linalg

from models.common.errors import InputError, listing, quoted
from models.roads.obstacles import OBSTACLES
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.linear.frequency_response import continuous_frequency_response
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.gallery.entries import Entry, PrintedNumber
from sim.studies.ride.between_samples import Pieces
from sim.studies.ride.between_samples import exact as between_samples
from sim.studies.ride.step_response import SignalSteps, measure_step
from synth.analysis.specification import ROBUST_PERFORMANCE
from synth.controller.controller import Controller
from synth.design.full_order.quadratic import h2_norm
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from synth.vehicle.paper import ours

OF_A_STEP = ("overshoot", "peak_time", "settling_time", "iae", "itae")  # kinds of numbers
OF_A_RUN = ("peak", "rms", "recovery", *OF_A_STEP)
OF_A_GRID = ("peak", "rms", "recovery", "overshoot", "settling_time")
ON_AXIS = 1e-12  # relative to its size: a part of a pole that is less is rounding
REAL = 1e-6  # relative to its size: a zero with less of a real part lies on the imaginary axis


@dataclass(frozen=True)
class ComparedNumber:
    """Published number next to ours.

    Attributes:
        printed: the number of the source.
        exact: value of linear analysis, in the unit of the source.
        mujoco: value in a run of MuJoCo, in that unit; None if no run shows it.
        grid: value of linear analysis at the samples of the source's grid, in that unit; None without a grid.
    """

    printed: PrintedNumber
    exact: float
    mujoco: float | None = None
    grid: float | None = None

    @property
    def reproduced(self) -> bool:
        """True if the exact number rounds to the printed digits, or that on the source's grid where no reason is given."""
        return self._rounds(self.exact) or self.on_its_grid

    @property
    def on_its_grid(self) -> bool:
        """True if it is reproduced on the source's grid alone."""
        there = self.grid is not None and not self.printed.reason and self._rounds(self.grid)
        return there and not self._rounds(self.exact)

    def _rounds(self, value: float) -> bool:
        return abs(value - self.printed.value) <= self.printed.half_digit

    @property
    def explained(self) -> bool:
        """True if it differs by no more than the entry's reason explains."""
        most = self.printed.half_digit + self.printed.within * abs(self.printed.value)
        return bool(self.printed.reason) and abs(self.exact - self.printed.value) <= most

    @property
    def wrong(self) -> bool:
        """True if it is neither reproduced nor explained."""
        return not self.reproduced and not self.explained

    @property
    def shown_exact(self) -> str:
        """The exact number with 9 digits, or with all if the source prints more."""
        return f"{self.exact:.{17 if self.printed.digits > 12 else 9}g}"

    @property
    def verdict(self) -> str:
        """Verdict in words."""
        if self.reproduced:
            return "reproduced on its grid" if self.on_its_grid else "reproduced"
        return f"differs: {self.printed.reason}" if self.explained else "NOT REPRODUCED"


@cache
def _designer(path: str) -> Designer:
    return Designer(read_vehicle(path))


def designer_of(entry: Entry, one: PrintedNumber) -> Designer:
    """Returns the designs of the vehicle that a number is of."""
    return _designer(one.vehicle if one.what == "paper" else str(entry.folder / one.vehicle))


def _norm(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    return linear_of(designer, one).certificate.norm.value, None


def _gain(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    return float(linear_of(designer, one).law.D[one.at]), None


def _robust_performance(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns the proved bound on mu with performance."""
    bounds = [promise.proved for promise in linear_of(designer, one).robustness if promise.what == ROBUST_PERFORMANCE]
    if not bounds or bounds[0] is None:
        raise InputError(f"controller {one.controller!r} has no weighted errors; give a weight in its tolerance")
    return bounds[0], None


def _zero(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns the smallest frequency above 0 at which no force changes a signal, a zero on the imaginary axis."""
    model = designer.vehicle.linear_model
    i = model.outputs.index(one.signal)
    pencil = np.block([[model.A, model.B[:, :1]], [model.C[i : i + 1], model.D[i : i + 1, :1]]])
    mass = np.diag([1.0] * len(model.A) + [0.0])
    zeros = linalg.eigvals(pencil, mass)
    zeros = zeros[np.isfinite(zeros)]
    above, off = np.imag(zeros), np.abs(np.real(zeros))
    on_axis = above[(off <= REAL * np.abs(zeros)) & (above > REAL * np.abs(zeros).max())]
    if not len(on_axis):
        raise InputError(f"{one.signal} has no zero on the imaginary axis from {model.inputs[0]}; give another signal")
    return float(on_axis.min()), None


def _ratio(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns the amplitude of a signal over that of the road's velocity under the first wheel."""
    omega = np.array([2 * np.pi * one.hertz])
    response = continuous_frequency_response(designer.vehicle, linear_of(designer, one), omega)
    return float(np.abs(response[0, designer.vehicle.linear_model.outputs.index(one.signal), 0])), None


def _white(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns the rms of a signal of the passive car on a road whose velocity is white noise of intensity one."""
    model = designer.vehicle.linear_model
    row = model.C[[model.outputs.index(one.signal)]]
    nothing, (r,) = np.zeros((1, 0)), model.Bw.shape[1:]
    return h2_norm(GeneralizedPlant(model.A, model.B[:, :0], model.Bw, row, nothing, np.zeros((1, r)))), None


def _pole(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns a part of a pole of the continuous loop.

    `at` is its number by rising real part, then by size, of each pair one; and 0 for the real or 1 for the imaginary part.
    """
    loop = linear_of(designer, one).loop(designer.vehicle)
    poles = np.linalg.eigvals(loop.A)
    poles = poles[poles.imag >= 0]
    if len(one.at) != 2 or not 0 <= one.at[0] < len(poles):
        raise InputError(
            f"at = {list(one.at)} is not a pole; give [0 to {len(poles) - 1}, 0 for its real or 1 for its imaginary part]"
        )
    k, part = one.at
    level = np.round(poles.real / np.abs(poles).max(), 9)  # of marginal poles rounding decides no order
    pole = poles[np.lexsort((np.abs(poles), level))][k]
    value = float(pole.imag if part else pole.real)
    return value if abs(value) > ON_AXIS * abs(pole) else 0.0, None


def _static(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns a tyre's deflection at rest, from where it carries nothing."""
    vehicle = designer.vehicle
    return -vehicle.kind.static_tyre_deflection(vehicle.parameters)[one.signal], None


def _peak(designer: Designer, one: PrintedNumber) -> tuple[float, float | None]:
    """Returns the largest size of a signal over a road, of the continuous loop between samples, and of MuJoCo.

    MuJoCo's is None if the linear regime ends, as where a step lifts a wheel.
    """
    run = driven(designer, one)
    pieces = pieces_of(designer, one)
    exact = max(pieces.largest()[0], pieces.times(-1.0).largest()[0])
    return exact, float(np.abs(run.physics[one.signal]).max()) if math.isinf(run.agreement.until) else None


def _rms(designer: Designer, one: PrintedNumber) -> tuple[float, float | None]:
    """Returns the root mean square of a signal over a road, of the continuous loop between samples, and of MuJoCo, as `_peak`."""
    run = driven(designer, one)
    exact = pieces_of(designer, one).rms()
    return exact, float(run.physics.rms(one.signal)) if math.isinf(run.agreement.until) else None


def _recovery(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns when a signal stays within a band around zero, from when the road begins [s].

    Raises:
        InputError: the signal does not settle, or is never outside the band.
    """
    begins = float(one.road.get("start", 0.0))
    last = pieces_of(designer, one).counted_from(begins).last_above(one.half_band)
    if last is None or math.isinf(last):
        raise InputError(f"{one.text}: the signal never leaves the band, or never settles; move it to `missing`")
    return last, None


def _of_step(key: str) -> Callable[[Designer, PrintedNumber], tuple[float, float | None]]:
    """Returns how a metric of a signal's response to a step is found, of the continuous loop and of MuJoCo."""

    def found(designer: Designer, one: PrintedNumber) -> tuple[float, float | None]:
        run = driven(designer, one)
        if (run_key(designer, one), one.band) not in _steps:
            _steps[run_key(designer, one), one.band] = measure_step(run, one.band, pieces_of_run(designer, one))
        metrics = _steps[run_key(designer, one), one.band][one.signal]
        physics = metrics.mujoco if math.isinf(run.agreement.until) else None
        exact, mujoco = (None if each is None else getattr(each, key) for each in (metrics.continuous, physics))
        if exact is None:
            raise InputError(f"{one.text}: it is {metrics.continuous and metrics.continuous.settled}; move it to `missing`")
        return exact, mujoco

    return found


def driven(designer: Designer, one: PrintedNumber) -> Run:
    """Returns the run that a number is of."""
    key = run_key(designer, one)
    if key not in _runs:
        numbers = dict(one.road)
        road = OBSTACLES[numbers.pop("type", "step" if "edge" in numbers else "bump")](**numbers)
        time = sample_times(designer.vehicle, one.duration, one.timestep)
        (_runs[key],) = run_controllers(designer.vehicle, [linear_of(designer, one)], road, time)
    return _runs[key]


def run_key(designer: Designer, one: PrintedNumber) -> tuple:
    """Returns what tells a number's run from others."""
    return designer.vehicle.source, one.controller, tuple(one.road.items()), one.duration, one.timestep


def pieces_of(designer: Designer, one: PrintedNumber) -> Pieces:
    """Returns a number's signal over its run, exact between samples."""
    return pieces_of_run(designer, one)[one.signal]


def pieces_of_run(designer: Designer, one: PrintedNumber) -> dict[str, Pieces]:
    """Returns all signals of a number's run, exact between samples."""
    key = run_key(designer, one)
    if key not in _pieces:
        run = driven(designer, one)
        _pieces[key] = between_samples(run, tuple(run.vehicle.linear_model.outputs))
    return _pieces[key]


_runs: dict[tuple, Run] = {}
_pieces: dict[tuple, dict[str, Pieces]] = {}
_steps: dict[tuple, dict[str, SignalSteps]] = {}


def _on_grid(designer: Designer, one: PrintedNumber) -> float:
    """Returns a number of a run as the source sees it, at the samples of its own grid.

    A time from which a signal stays within a band is the first sample of the grid within it.
    """
    if one.what not in OF_A_GRID or not one.timestep / 10 <= one.grid <= one.duration:
        raise InputError(f"grid = {one.grid:g} s is of a peak or an rms, from {one.timestep / 10:g} s to the duration; omit it")
    times = np.arange(round(one.duration / one.grid, 6) // 1 + 1) * one.grid
    values = pieces_of(designer, one).at(times)
    if one.what in ("peak", "rms"):
        return float(np.abs(values).max() if one.what == "peak" else np.sqrt(np.mean(values**2)))
    height = float(one.road.get("height", 0.0))
    if one.what == "overshoot":
        return float(max(np.max(values / height) - 1, 0.0))
    far = np.abs(values) if one.what == "recovery" else np.abs(values - height)
    outside = np.flatnonzero(far > (one.half_band or one.band / 100 * abs(height)))
    return float(times[outside[-1] + 1] - one.road.get("start", 0.0))


@cache
def _of_paper() -> dict:
    return ours(_designer("quarter_car"))


def _paper(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    value = _of_paper()[one.symbol]
    return float(value[one.at] if isinstance(value, np.ndarray) else value), None


KINDS: dict[str, Callable[[Designer, PrintedNumber], tuple[float, float | None]]] = {
    "norm": _norm,
    "gain": _gain,
    "robust_performance": _robust_performance,
    "zero": _zero,
    "ratio": _ratio,
    "white": _white,
    "peak": _peak,
    "rms": _rms,
    "recovery": _recovery,
    **{key: _of_step(key) for key in OF_A_STEP},
    "pole": _pole,
    "static": _static,
    "paper": _paper,
}


def linear_of(designer: Designer, one: PrintedNumber) -> Controller:
    """Returns the controller of a number; raises an InputError if it is not linear."""
    controller = designer.design(one.controller)
    if not isinstance(controller, Controller):
        raise InputError(f"controller {one.controller!r} is not linear, and has no {one.what}; name a linear one")
    return controller


def compared(entry: Entry) -> list[ComparedNumber]:
    """Returns the numbers of an entry beside ours, in the order of the entry.

    Raises:
        InputError: a number's kind, signal, controller or vehicle file is unknown.
    """
    numbers = []
    for one in entry.printed:
        if one.what not in KINDS:
            raise InputError(f"{entry.name}: what = {quoted(one.what)} is not allowed; one of {listing(KINDS)}")
        designer = designer_of(entry, one)
        _check_signal(entry, designer.vehicle, one)
        exact, mujoco = KINDS[one.what](designer, one)
        grid = one.scale * _on_grid(designer, one) if one.grid else None
        numbers.append(ComparedNumber(one, one.scale * exact, None if mujoco is None else one.scale * mujoco, grid))
    return numbers


def _check_signal(entry: Entry, vehicle: Vehicle, one: PrintedNumber) -> None:
    outputs = vehicle.linear_model.outputs
    if one.signal and one.signal not in outputs:
        raise InputError(f"{entry.name}: unknown signal {one.signal!r}; this vehicle has {listing(outputs)}")
