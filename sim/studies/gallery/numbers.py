"""Computation of the gallery's numbers by linear analysis and, for each number that a run can measure, in MuJoCo."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import linalg

from models.common.errors import InputError, list_names, short_repr
from models.roads.road import Road
from models.vehicle.vehicle import read_vehicle
from sim.linear.frequency_response import continuous_frequency_response
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.gallery.entries import Entry, PrintedNumber
from sim.studies.ride.between_samples import Pieces
from sim.studies.ride.between_samples import exact as between_samples
from sim.studies.ride.step_response import SignalSteps, measure_step
from synth.analysis.specification import ROBUST_PERFORMANCE
from synth.design.full_order.quadratic import h2_norm
from synth.plant.generalized import Plant
from synth.vehicle.designer import Designer
from synth.vehicle.paper import ours

OF_A_STEP = ("overshoot", "peak_time", "settling_time", "iae", "itae")  # types of numbers that are computed from a step response
OF_A_RUN = ("peak", "rms", "recovery", *OF_A_STEP)
OF_A_GRID = ("peak", "rms", "recovery", "overshoot", "settling_time")
REPRODUCED, ON_ITS_GRID, DIFFERS, WRONG = "reproduced", "reproduced on its grid", "differs", "NOT REPRODUCED"
ON_AXIS = 1e-12  # the real or imaginary part of a pole counts as 0 if it is a smaller share of the pole's magnitude than this
REAL = 1e-6  # a zero of a transfer function counts as imaginary if its real part is smaller than this share of its magnitude


@dataclass(frozen=True)
class ComparedNumber:
    """A published number, and the same number computed by Roadproof. All values of the number have the unit that the source
    uses.

    Attributes:
        printed: number as it was published in the source.
        exact: value of the number according to linear analysis.
        mujoco: value of the number, measured in a MuJoCo run; None if the number cannot be measured in a run.
        grid: value of the number at the sample times of the source, from linear analysis; None if these times are unknown.
    """

    printed: PrintedNumber
    exact: float
    mujoco: float | None = None
    grid: float | None = None

    @property
    def verdict(self) -> str:
        """Verdict on the comparison of a published number with the computed number.

        - `REPRODUCED`: the exact value rounds to all published digits.
        - `ON_ITS_GRID`: the value at the source's sample times rounds to all published digits, and the entry gives no reason
          for a difference.
        - `DIFFERS`: the entry gives a reason for the difference, and the difference is within the limit that belongs to this
          reason.
        - `WRONG`: none of the other verdicts applies.
        """
        one, off = self.printed, abs(self.exact - self.printed.value)
        half = 0.5 * 10.0**-one.digits * (1 + 1e-9)
        if off <= half:
            return REPRODUCED
        if self.grid is not None and not one.reason and abs(self.grid - one.value) <= half:
            return ON_ITS_GRID
        return DIFFERS if one.reason and off <= half + one.within * abs(one.value) else WRONG


@cache
def _designer(path: str) -> Designer:
    return Designer(read_vehicle(path))


def designer_of(entry: Entry, one: PrintedNumber) -> Designer:
    """Returns the `Designer` for the vehicle to which a published number refers."""
    return _designer(one.vehicle if one.what == "paper" else str(entry.folder / one.vehicle))


def _robust_performance(designer: Designer, one: PrintedNumber) -> float:
    """Returns the proved bound on the structured singular value mu for robust performance."""
    bounds = [promise.proved for promise in designer.design(one.controller).robustness if promise.what == ROBUST_PERFORMANCE]
    if not bounds or bounds[0] is None:
        raise InputError(
            f"controller {one.controller!r} has no uncertainty with a weight, but this number is a bound for such "
            "uncertainties; give a weight in the tolerance of this controller"
        )
    return bounds[0]


def _zero(designer: Designer, one: PrintedNumber) -> float:
    """Returns the smallest frequency above 0 [rad/s] of a zero on the imaginary axis, in the transfer function from the first
    force to a signal.
    """
    model = designer.vehicle.linear_model
    i = model.outputs.index(one.signal)
    pencil = np.block([[model.A, model.B[:, :1]], [model.C[i : i + 1], model.D[i : i + 1, :1]]])
    zeros = linalg.eigvals(pencil, np.diag([1.0] * len(model.A) + [0.0]))
    zeros = zeros[np.isfinite(zeros)]
    above, off = np.imag(zeros), np.abs(np.real(zeros))
    on_axis = above[(off <= REAL * np.abs(zeros)) & (above > REAL * np.abs(zeros).max())]
    if not len(on_axis):
        raise InputError(
            f"the transfer function to {one.signal} from {model.inputs[0]} has no zero on the imaginary axis; give a "
            "different signal"
        )
    return float(on_axis.min())


def _ratio(designer: Designer, one: PrintedNumber) -> float:
    """Returns the amplitude of a signal divided by the amplitude of the road velocity under the first wheel, at one frequency."""
    omega = np.array([2 * np.pi * one.hertz])
    response = continuous_frequency_response(designer.vehicle, designer.design(one.controller), omega)
    return float(np.abs(response[0, designer.vehicle.linear_model.outputs.index(one.signal), 0]))


def _white(designer: Designer, one: PrintedNumber) -> float:
    """Returns the rms of a signal of the passive vehicle for a road velocity that is white noise with intensity 1."""
    model = designer.vehicle.linear_model
    row = model.C[[model.outputs.index(one.signal)]]
    return h2_norm(Plant.without_inputs(model.A, model.Bw, row, np.zeros((1, model.Bw.shape[1]))))


def _pole(designer: Designer, one: PrintedNumber) -> float:
    """Returns the real or imaginary part of a pole of the continuous loop [1/s].

    `one.at` contains the number of the pole, followed by 0 for the real part or 1 for the imaginary part. Poles are numbered by
    increasing real part, then by increasing magnitude. The two poles of a complex-conjugate pair have one common number.
    """
    loop = designer.design(one.controller).loop(designer.vehicle)
    poles = np.linalg.eigvals(loop.A)
    poles = poles[poles.imag >= 0]
    if len(one.at) != 2 or not 0 <= one.at[0] < len(poles):
        raise InputError(
            f"at = {list(one.at)} does not select a pole; give two numbers: the pole, from 0 to {len(poles) - 1}, and 0 for "
            "its real part or 1 for its imaginary part"
        )
    k, part = one.at
    # The values are rounded, so that rounding errors do not determine the order of undamped poles
    level = np.round(poles.real / np.abs(poles).max(), 9)
    pole = poles[np.lexsort((np.abs(poles), level))][k]
    value = float(pole.imag if part else pole.real)
    return value if abs(value) > ON_AXIS * abs(pole) else 0.0


def _recovery(designer: Designer, one: PrintedNumber) -> float:
    """Returns the time from the start of the road until a signal stays within a band around zero [s].

    Raises:
        InputError: the signal does not settle, or never leaves the band.
    """
    begins = getattr(one.road, "start", 0.0)
    last = pieces_of(designer, one).counted_from(begins).last_above(one.half_band)
    if last is None or math.isinf(last):
        raise InputError(
            f"{one.text}: this number does not exist, because the signal never leaves the band, or never settles in it; "
            "move the number from [[printed]] to [[missing]]"
        )
    return last


def _of_step(key: str) -> Callable[[Designer, PrintedNumber], float]:
    """Returns a function that computes a metric from a signal's step response in the continuous loop.

    Args:
        key: name of the step-response metric, which must be a key of `OF_A_STEP`.
    """

    def found(designer: Designer, one: PrintedNumber) -> float:
        metrics = _steps(run_of_number(designer, one), one.band)[one.signal].continuous
        value = None if metrics is None else getattr(metrics, key)
        if value is None:
            raise InputError(
                f"{one.text}: the signal is {metrics and metrics.settled}, so this number does not exist; move the number "
                "from [[printed]] to [[missing]]"
            )
        return value

    return found


def run_of_number(designer: Designer, one: PrintedNumber) -> Run:
    """Returns the MuJoCo run in which a published number is measured. Published numbers that are measured in the same run share
    one `Run` object.
    """
    return _run(designer, one.controller, one.road, one.duration, one.timestep)


@cache
def _run(designer: Designer, controller: str, road: Road, duration: float, timestep: float) -> Run:
    time = sample_times(designer.vehicle, duration, timestep)
    return run_controllers(designer.vehicle, [designer.design(controller)], road, time)[0]


def pieces_of(designer: Designer, one: PrintedNumber) -> Pieces:
    """Returns the signal to which a published number refers, over its whole run and exact between samples."""
    return _pieces(run_of_number(designer, one))[one.signal]


@cache
def _pieces(run: Run) -> dict[str, Pieces]:
    return between_samples(run, tuple(run.vehicle.linear_model.outputs))


@cache
def _steps(run: Run, band: float) -> dict[str, SignalSteps]:
    return measure_step(run, band, _pieces(run))


def _in_mujoco(designer: Designer, one: PrintedNumber) -> float | None:
    """Returns the value of a published number in MuJoCo [SI]; None if the number cannot be measured in a run, or the run leaves
    the linear regime.
    """
    if one.what not in OF_A_RUN or one.what == "recovery" or not math.isinf(run_of_number(designer, one).agreement.until):
        return None
    run = run_of_number(designer, one)
    if one.what in OF_A_STEP:
        return getattr(_steps(run, one.band)[one.signal].mujoco, one.what, None)
    return float(run.physics.rms(one.signal) if one.what == "rms" else np.abs(run.physics[one.signal]).max())


def _on_grid(designer: Designer, one: PrintedNumber) -> float:
    """Computes a published number from the signal only at the source's sample times, and returns the number in SI units.

    A settling or recovery time ends at the first sample after which the signal stays within the band.
    """
    least = one.timestep / 10
    if one.what not in OF_A_GRID or not least <= one.grid <= one.duration:
        raise InputError(
            f"grid = {one.grid:g} s is not allowed for what = {one.what}; give a number from {least:g} s to the duration of "
            "the run, or omit grid"
        )
    times = np.arange(round(one.duration / one.grid, 6) // 1 + 1) * one.grid
    values = pieces_of(designer, one).at(times)
    if one.what in ("peak", "rms"):
        return float(np.abs(values).max() if one.what == "peak" else np.sqrt(np.mean(values**2)))
    height = getattr(one.road, "height", 0.0)
    if one.what == "overshoot":
        return float(max(np.max(values / height) - 1, 0.0))
    far = np.abs(values) if one.what == "recovery" else np.abs(values - height)
    outside = np.flatnonzero(far > (one.half_band or one.band / 100 * abs(height)))
    return float(times[outside[-1] + 1] - getattr(one.road, "start", 0.0))


@cache
def _of_paper() -> dict:
    return ours(_designer("quarter_car"))


def _paper(designer: Designer, one: PrintedNumber) -> float:
    value = _of_paper()[one.symbol]
    return float(value[one.at] if isinstance(value, np.ndarray) else value)


# For each type of number, the function that computes it by linear analysis, in SI units.
KINDS: dict[str, Callable[[Designer, PrintedNumber], float]] = {
    "norm": lambda designer, one: designer.design(one.controller).certificate.norm.value,
    "gain": lambda designer, one: float(designer.design(one.controller).law.D[one.at]),
    "robust_performance": _robust_performance,
    "zero": _zero,
    "ratio": _ratio,
    "white": _white,
    "peak": lambda designer, one: max(pieces_of(designer, one).times(sign).largest()[0] for sign in (1.0, -1.0)),
    "rms": lambda designer, one: pieces_of(designer, one).rms(),
    "recovery": _recovery,
    **{key: _of_step(key) for key in OF_A_STEP},
    "pole": _pole,
    "static": lambda designer, one: -designer.vehicle.kind.static_tyre_deflection(designer.vehicle.parameters)[one.signal],
    "paper": _paper,
}


def compare_numbers(entry: Entry) -> list[ComparedNumber]:
    """Computes the numbers of an entry, and returns them with the published numbers in the order of the entry.

    Raises:
        InputError: the type, signal, controller or vehicle file of a number is unknown.
    """
    numbers = []
    for one in entry.printed:
        if one.what not in KINDS:
            raise InputError(f"{entry.name}: what = {short_repr(one.what)} is not allowed; give one of {list_names(KINDS)}")
        designer = designer_of(entry, one)
        outputs = designer.vehicle.linear_model.outputs
        if one.signal and one.signal not in outputs:
            raise InputError(f"{entry.name}: unknown signal {one.signal!r}; this vehicle has {list_names(outputs)}")
        exact, mujoco = KINDS[one.what](designer, one), _in_mujoco(designer, one)
        grid = one.scale * _on_grid(designer, one) if one.grid else None
        numbers.append(ComparedNumber(one, one.scale * exact, None if mujoco is None else one.scale * mujoco, grid))
    return numbers
