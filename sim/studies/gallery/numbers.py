"""Numbers of the gallery, computed here: exactly, and in MuJoCo where a run shows them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import linalg

from models.common.errors import InputError, listing, quoted
from models.roads.obstacles import Step
from models.roads.road import Bump
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.linear.frequency_response import continuous_frequency_response
from sim.runs.run import run_controllers, sample_times
from sim.studies.gallery.entries import Entry, PrintedNumber
from synth.controller.controller import Controller
from synth.controller.open_loop import continuous
from synth.design.full_order.quadratic import h2_norm
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from synth.vehicle.paper import ours

DURATION, TIMESTEP = 3.0, 1e-3  # s; a car has settled after a bump
STEP_DURATION, STEP_TIMESTEP = 1.0, 1e-4  # s; a tyre that damps answers a step within milliseconds
REAL = 1e-6  # relative to its size: a zero with less of a real part lies on the imaginary axis


@dataclass(frozen=True)
class ComparedNumber:
    """Number of a source beside ours.

    Attributes:
        printed: the number of the source.
        exact: of linear analysis, in the unit of the source.
        mujoco: in a run of MuJoCo, likewise; None if no run shows it.
    """

    printed: PrintedNumber
    exact: float
    mujoco: float | None = None

    @property
    def reproduced(self) -> bool:
        """True if the exact number rounds to the printed digits."""
        return abs(self.exact - self.printed.value) <= self.printed.half_digit

    @property
    def explained(self) -> bool:
        """True if it differs by no more than the entry's reason explains."""
        most = self.printed.half_digit + self.printed.within * abs(self.printed.value)
        return bool(self.printed.reason) and abs(self.exact - self.printed.value) <= most

    @property
    def verdict(self) -> str:
        """Verdict in words."""
        if self.reproduced:
            return "reproduced"
        return f"differs: {self.printed.reason}" if self.explained else "NOT REPRODUCED"


@cache
def _designer(path: str) -> Designer:
    return Designer(read_vehicle(path))


def _norm(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    return _linear(designer, one).certificate.norm.value, None


def _gain(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    return float(_linear(designer, one).law.D[one.at]), None


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
        raise InputError(f"{one.signal} has no zero on the imaginary axis from {model.inputs[0]}; name another signal")
    return float(on_axis.min()), None


def _ratio(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns the amplitude of a signal over that of the road's velocity under the first wheel."""
    omega = np.array([2 * np.pi * one.hertz])
    response = continuous_frequency_response(designer.vehicle, _linear(designer, one), omega)
    return float(np.abs(response[0, designer.vehicle.linear_model.outputs.index(one.signal), 0])), None


def _white(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns the rms of a signal of the passive car on a road whose velocity is white noise of intensity one."""
    model = designer.vehicle.linear_model
    row = model.C[[model.outputs.index(one.signal)]]
    nothing, (r,) = np.zeros((1, 0)), model.Bw.shape[1:]
    return h2_norm(GeneralizedPlant(model.A, model.B[:, :0], model.Bw, row, nothing, np.zeros((1, r)))), None


def _peak(designer: Designer, one: PrintedNumber) -> tuple[float, float | None]:
    """Returns the largest size of a signal over a bump or a step, of the continuous loop and of MuJoCo.

    MuJoCo's is None if the linear regime ends, as where a step lifts a wheel.
    """
    vehicle, step = designer.vehicle, "edge" in one.road
    road = Step(**one.road) if step else Bump(**one.road)
    time = sample_times(vehicle, STEP_DURATION, STEP_TIMESTEP) if step else sample_times(vehicle, DURATION, TIMESTEP)
    (run,) = run_controllers(vehicle, [_linear(designer, one)], road, time)
    exact, mujoco = (float(np.abs(each[one.signal]).max()) for each in (run.continuous, run.physics))
    return exact, mujoco if np.isinf(run.agreement.until) else None


def _pole(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    """Returns a part of a pole of the loop: `at` is its number by rising real part, of each pair one, and 0 or 1 for the part."""
    cut = continuous(designer.vehicle, _linear(designer, one))
    poles = np.linalg.eigvals(cut.model.A + cut.model.B @ cut.G)
    upper = sorted((pole for pole in poles if pole.imag >= 0), key=lambda pole: pole.real)
    number, part = one.at
    return float(upper[number].imag if part else upper[number].real), None


@cache
def _of_paper() -> dict:
    return ours(_designer("quarter_car"))


def _paper(designer: Designer, one: PrintedNumber) -> tuple[float, None]:
    value = _of_paper()[one.symbol]
    return float(value[one.at] if isinstance(value, np.ndarray) else value), None


KINDS: dict[str, Callable[[Designer, PrintedNumber], tuple[float, float | None]]] = {
    "norm": _norm,
    "gain": _gain,
    "zero": _zero,
    "ratio": _ratio,
    "white": _white,
    "peak": _peak,
    "pole": _pole,
    "paper": _paper,
}


def _linear(designer: Designer, one: PrintedNumber) -> Controller:
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
        path = one.vehicle if one.what == "paper" else str(entry.folder / one.vehicle)
        designer = _designer(path)
        _check_signal(entry, designer.vehicle, one)
        exact, mujoco = KINDS[one.what](designer, one)
        numbers.append(ComparedNumber(one, one.scale * exact, None if mujoco is None else one.scale * mujoco))
    return numbers


def _check_signal(entry: Entry, vehicle: Vehicle, one: PrintedNumber) -> None:
    outputs = vehicle.linear_model.outputs
    if one.signal and one.signal not in outputs:
        raise InputError(f"{entry.name}: unknown signal {one.signal!r}; this vehicle has {listing(outputs)}")
