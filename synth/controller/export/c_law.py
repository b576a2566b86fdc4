"""Computation of a controller that is exported as code, with the implementation in the vehicle file, and the same computation
in Python.

In each sample period, the computation has these steps:

1. An input that is not finite is replaced by its last finite value.
2. Measurements are quantised.
3. The forces of a linear law are summed over the measurements, then over the states, in the order of the matrix columns.
4. The forces are limited, and then their changes per sample are limited. For semi-active dampers, the forces are converted to
   damping coefficients instead of being limited.
5. The next states are computed as sums, which are also added in the order of the matrix columns.
6. The outputs that were computed `delay` samples earlier are returned.

A force or a state that overflows is set to 0. C and Python perform the same operations in the same order and number format.
The results of C and Python are therefore equal bit for bit.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.laws.anti_windup import anti_windup_gain
from models.laws.linear import LinearLaw, static_law
from models.laws.semi_active import LAWS, LawCoefficients
from models.vehicle.semi_active_coefficients import numbers_of
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import AnyController
from synth.controller.export.fixed_point import BITS, FixedPoint, fixed_point, rounded_shift

NUMBERS = {"double": np.float64, "float": np.float32, "int32": np.int32, "int16": np.int16}
STILL = {"double": 1e-150, "float": 1e-30}  # small velocity that replaces 0 in divisions [m/s]
# a measurement of this magnitude or larger is invalid
LARGEST = {"double": float(np.finfo(float).max), "float": float(np.finfo(np.float32).max)}
NEAREST = {"double": 2.0**52, "float": 2.0**23}  # a number of this magnitude or larger has no fractional part
GIVEN_RANGE = "given"  # name of the source of a range that the user gave; such a range does not follow from a proved peak
SPARE = 1.1  # factor that enlarges a proved peak, to allow for the effects of sampling and rounding
KEYWORDS = frozenset(
    ("auto", "const", "default", "double", "float", "int", "long", "short", "static", "switch", "void")
)  # keywords of C that a user might choose as the name of a controller


@dataclass(frozen=True, eq=False)
class ExportedLaw:
    """Controller in the form in which a vehicle's control computer executes it.

    Attributes:
        name: prefix of all names in the C code.
        controller: name of the controller in the vehicle file.
        numbers: number format: "double", "float", "int32" or "int16".
        period: sample period [s]; None for a law without states that needs no sample period.
        inputs: names of the q measurements, followed by the names of the velocities of suspensions with a semi-active damper.
        units: units of the inputs.
        meanings: one-line description of each input.
        outputs: names of the m forces, or of the m damping coefficients.
        output_units: units of the outputs.
        law: sampled linear law with k states; a law with zero gains if the controller is semi-active.
        resolution: quantisation step of each measurement, shape (q,); 0 for a measurement that is not quantised.
        limit: largest allowed magnitude of each force [N]; None without limit.
        change: largest allowed change of a force per sample [N]; None without limit.
        delay: delay from the measurements to the outputs that are computed from them [samples].
        anti_windup: anti-windup gain, shape (k, m); None without anti-windup.
        dampers: nominal coefficient of each semi-active damper, and the smallest and largest difference from this coefficient
            [N s/m]; empty for force actuators.
        semi_active: name of the semi-active law; empty for a linear law.
        coefficients: parameters of the semi-active law; None for a linear law.
        modes: number of measurements of body modes, which come before the measurements of the suspensions.
        ranges: largest magnitude of each measurement for fixed-point code, shape (q,); None for floating point.
        range_sources: text that describes the source of each range.
    """

    name: str
    controller: str
    numbers: str
    period: float | None
    inputs: tuple[str, ...]
    units: tuple[str, ...]
    meanings: tuple[str, ...]
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    law: LinearLaw
    resolution: Array
    limit: float | None
    change: float | None
    delay: int
    anti_windup: Array | None
    dampers: tuple[tuple[float, float, float], ...]
    semi_active: str = ""
    coefficients: LawCoefficients | None = None
    modes: int = 0
    ranges: Array | None = None
    range_sources: tuple[str, ...] = ()

    @cached_property
    def fixed(self) -> FixedPoint | None:
        """Units and integer coefficients of a fixed-point law; None for floating point."""
        if self.ranges is None:
            return None
        return fixed_point(self.numbers, self.law, self.anti_windup, self.limit, self.change, self.resolution, self.ranges)

    @cached_property
    def tables(self) -> dict[str, Array]:
        """Tables A, B, C, D and anti-windup L of the code, by name; integers for fixed point."""
        if (of := self.fixed) is None:
            L = np.zeros((self.states, 0)) if self.anti_windup is None else self.anti_windup
            return {name: getattr(self.law, name) for name in "ABCD"} | {"L": L}
        m, q, after = len(self.outputs), self.readings, self.readings + self.states
        L = of.rows[m:, after:] if self.anti_windup is not None else np.zeros((self.states, 0))
        return {"A": of.rows[m:, q:after], "B": of.rows[m:, :q], "C": of.rows[:m, q:after], "D": of.rows[:m, :q], "L": L}

    @property
    def largest(self) -> dict[str, float] | None:
        """Largest magnitude of each measurement of a fixed-point law, by name; None for floating point."""
        return None if self.ranges is None else dict(zip(self.inputs, self.ranges.tolist(), strict=True))

    @property
    def states(self) -> int:
        """Number k of states of the law."""
        return self.law.states

    @property
    def readings(self) -> int:
        """Number q of measurements, not counting the velocities of the suspensions."""
        return len(self.resolution)


def c_name(name: str) -> str:
    """Returns the name of a controller as a valid C name."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"law_{plain}" if plain[0].isdigit() or plain[0] == "_" or plain in KEYWORDS else plain


def exported_law(
    vehicle: Vehicle,
    driver: AnyController,
    numbers: str,
    name: str,
    ranges: Mapping[str, float] | None = None,
    sources: Mapping[str, str] | None = None,
) -> ExportedLaw:
    """Converts a controller to the form in which it is exported.

    Args:
        vehicle: vehicle with its limits and implementation.
        driver: controller of this vehicle.
        numbers: number format, as in `ExportedLaw`.
        name: prefix of all names in the C code.
        ranges: largest magnitude of each measurement, by its name; used for fixed-point code. Measurements whose peak is proved
            may be omitted.
        sources: description of the source of each range that the user did not give, by name of the measurement.

    Raises:
        InputError: the controller is a Python law or an FMU, has no sample period although it needs one, or controls dampers
            that cannot be exported.
    """
    how, model = vehicle.implementation, vehicle.linear_model
    if driver.user_code is True:
        raise InputError(
            f"controller {driver.name!r} is {driver.kind}, which is already code; export a linear or semi-active law"
        )
    if not driver.measured:
        raise InputError(
            f"controller {driver.name!r} measures nothing and gives no force, so there is nothing to export; export a "
            "different controller"
        )
    if not all(damper.replaces for damper in vehicle.dampers.values()):
        raise InputError(
            "dampers in [parts] with largest_voltage cannot be exported, because no sensor measures the states of these "
            "dampers; omit largest_voltage, or give [actuators] with c_min and c_max"
        )
    if vehicle.dampers and any(one.damper.pair is not None for one in vehicle.parts.adjustable):
        raise InputError("semi-active dampers with curves c_min and c_max cannot be exported; give c_min and c_max as numbers")
    if driver.linear and any(one.ratio != 1 for one in vehicle.parts.adjustable):
        raise InputError(
            "a linear law for semi-active dampers with a motion ratio cannot be exported; export a semi-active law instead"
        )
    if vehicle.dampers and len(vehicle.parts.adjustable) != len(model.inputs):
        raise InputError(
            "semi-active dampers and force actuators cannot be exported together; give all suspensions the same kind of actuator"
        )
    if how.delay != int(how.delay):
        raise InputError(
            f"delay = {how.delay:g} samples is not an integer, but exported code can change forces only at samples; "
            f"give delay = {int(how.delay)}"
        )
    q, m, k = len(driver.measured), len(model.inputs), driver.states
    if k and how.sample_period is None:
        raise InputError(
            f"controller {driver.name!r} has {k} state{'s' * (k > 1)}, so its code needs a sample period; give "
            "sample_period in [implementation], or export a static gain"
        )
    rate = vehicle.limits.force_rate
    if rate is not None and how.sample_period is None:
        raise InputError(
            "force_rate limits the change of a force from sample to sample, so the code needs a sample period; give "
            "sample_period in [implementation]"
        )
    velocities = [one.velocity for one in vehicle.kind.suspensions] if vehicle.dampers and driver.linear else []
    read = [*map(vehicle.kind.signal, driver.measured), *velocities]
    outputs = tuple(one.coefficient for one in vehicle.parts.adjustable) if vehicle.dampers else model.inputs
    limits, sources_of = _ranges(vehicle, driver, ranges or {}, sources or {}) if numbers in BITS else (None, ())
    common: dict[str, Any] = {
        "name": name,
        "controller": driver.name,
        "numbers": numbers,
        "period": how.sample_period,
        "inputs": (*driver.measured, *(one.name if one.name not in driver.measured else f"{one.name}_now" for one in velocities)),
        "units": tuple(one.unit for one in read),
        "meanings": tuple(one.meaning for one in read),
        "outputs": outputs,
        "output_units": tuple(["N s/m" if vehicle.dampers else "N"] * m),
        "resolution": np.array([how.quantisation.get(one, 0.0) for one in driver.measured]),
        "limit": None if vehicle.dampers else vehicle.limits.actuator_force,
        "change": None if rate is None or how.sample_period is None else rate * how.sample_period,
        "delay": int(how.delay),
        "dampers": tuple((one.nominal, one.low, one.high) for one in vehicle.parts.adjustable),
        "ranges": limits,
        "range_sources": sources_of,
    }
    if driver.linear is False:
        common |= {"law": static_law(np.zeros((m, q))), "anti_windup": None, "coefficients": numbers_of([driver.law], [vehicle])}
        return ExportedLaw(**common, semi_active=driver.law.name, modes=len(driver.law.modes))
    law = driver.law.sampled(how.sample_period) if how.sample_period is not None else driver.law
    L = anti_windup_gain(law) if law.anti_windup is not None and k else None
    made = ExportedLaw(**common, law=law, anti_windup=L)
    made.fixed  # noqa: B018 - errors of the fixed-point conversion are raised here
    return made


def proved_ranges(driver: AnyController) -> dict[str, tuple[float, str]]:
    """Returns the range of every measurement whose peak is bounded by a goal, and a description of the source of this range, by
    name.

    The proved peak is valid for the ideal loop, so the factor `SPARE` allows for the effects of sampling and rounding. A
    measurement is clipped at its range.
    """
    found = dict[str, tuple[float, str]]()
    for name in driver.measured:
        for promise in getattr(driver, "specifications", ()):
            what, proved = promise.what.removeprefix(f"largest {name} "), promise.proved
            if what == promise.what or proved is None or not 0 < proved < np.inf:
                continue
            if name not in found or SPARE * proved > found[name][0]:
                found[name] = SPARE * proved, f"{SPARE:g} times its peak {what}, proved to be at most {proved:.4g} {promise.unit}"
    return found


def _ranges(
    vehicle: Vehicle, driver: AnyController, given: Mapping[str, float], sources: Mapping[str, str]
) -> tuple[Array, tuple[str, ...]]:
    """Returns the fixed-point range of each measurement of a controller, shape (q,), and a description of the source of each
    range.

    Raises:
        InputError: a measurement has no range, a range belongs to no measurement, or the controller acts on dampers.
    """
    if vehicle.dampers:
        raise InputError(
            "integer code needs force actuators, but this vehicle has semi-active dampers; use double or float numbers"
        )
    unknown = [name for name in given if name not in driver.measured]
    if unknown:
        raise InputError(
            f"--range {unknown[0]}: controller {driver.name!r} measures only {list_names(driver.measured)}; omit this --range"
        )
    known = proved_ranges(driver) | {name: (most, sources.get(name, GIVEN_RANGE)) for name, most in given.items()}
    lacking = [name for name in driver.measured if name not in known]
    if lacking:
        name = lacking[0]
        raise InputError(f"integer code needs the largest magnitude of {name}; give this magnitude with --range {name}=NUMBER")
    return np.array([known[name][0] for name in driver.measured]), tuple(known[name][1] for name in driver.measured)


@dataclass
class PythonStep:
    """Exported computation in Python, whose results equal the results of the C code bit for bit.

    Attributes:
        law: exported law.
    """

    law: ExportedLaw
    _x: list[Any] = field(default_factory=list)
    _line: list[list[Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        law, fixed = self.law, self.law.fixed
        # Built-in Python floats have the same bits as float64, and their arithmetic is five times as fast.
        self._number = NUMBERS[law.numbers] if law.numbers == "float" else float if fixed is None else int
        self._tables = {name: [self._all(row) for row in table.tolist()] for name, table in law.tables.items()}
        self._resolution, self._ends = self._all(law.resolution.tolist()), [self._all(one) for one in law.dampers]
        self._limits = None if law.limit is None else self._all([law.limit] * len(law.outputs))
        self._changes = None if law.change is None else self._all([law.change] * len(law.outputs))
        if fixed is not None and fixed.limit is not None:
            self._limits = self._all(fixed.limit.tolist())
        if fixed is not None and fixed.change is not None:
            self._changes = self._all(fixed.change.tolist())
        self._x, self._given = [self._number(0)] * law.states, [self._number(0)] * len(law.outputs)
        still = [one[0] for one in self._ends] or [self._number(0)] * len(law.outputs)
        self._line = [still for _ in range(law.delay)]
        self._valid = [self._number(0)] * len(law.inputs)

    def _all(self, values: Sequence[float]) -> list[Any]:
        return [self._number(value) for value in values]

    def __call__(self, seen: Sequence[float]) -> list[Any]:
        """Returns the outputs that the law computes from the inputs of one sample; for fixed point, inputs and outputs are
        integers.
        """
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            self._line.append(self._computed(self._read(seen)))
        return self._line.pop(0)

    def _read(self, seen: Sequence[float]) -> list[Any]:
        """Returns valid inputs: inputs are clipped for fixed point; otherwise, the last finite value replaces an input that is
        not finite.
        """
        values = self._all(seen)
        if (fixed := self.law.fixed) is not None:
            return [self._clipped(value, -fixed.largest, fixed.largest) for value in values]
        self._valid = [self._valid_or(value, last) for value, last in zip(values, self._valid, strict=True)]
        return self._valid

    def _settled(self, total: Any, row: int) -> Any:
        """Returns the value that is stored for a sum: scaled and rounded for fixed point, otherwise 0 if the sum overflows."""
        if (fixed := self.law.fixed) is not None:
            return rounded_shift(total, int(fixed.shifts[row]), fixed.largest)
        return self._valid_or(total, self._number(0))

    def _computed(self, seen: list[Any]) -> list[Any]:
        law, of, q, m = self.law, self._tables, self.law.readings, len(self.law.outputs)
        y = seen if law.fixed is not None else [self._quantised(*both) for both in zip(seen[:q], self._resolution, strict=True)]
        if law.semi_active:
            requested = [self._valid_or(c, n) for c, (n, _, _) in zip(self._semi_active(y), self._ends, strict=True)]
            return [self._clipped(c - n, low, high) + n for c, (n, low, high) in zip(requested, self._ends, strict=True)]
        forces = [self._settled(self._sum((of["D"][j], y), (of["C"][j], self._x)), j) for j in range(m)]
        given = out = forces
        if law.dampers:
            closing = [self._number(STILL[law.numbers]) if value == 0 else -value for value in seen[q:]]
            beyond = [self._clipped(f / v, low, high) for f, v, (_, low, high) in zip(forces, closing, self._ends, strict=True)]
            given = [c * v for c, v in zip(beyond, closing, strict=True)]
            out = [n + c for c, (n, _, _) in zip(beyond, self._ends, strict=True)]
        elif self._limits is not None:
            given = out = [self._clipped(force, -most, most) for force, most in zip(forces, self._limits, strict=True)]
        if self._changes is not None:
            steps = zip(given, self._given, self._changes, strict=True)
            self._given = [self._clipped(force, last - step, last + step) for force, last, step in steps]
            given = out = self._given
        missing = [] if law.anti_windup is None else [g - f for g, f in zip(given, forces, strict=True)]
        rows = zip(of["A"], of["B"], of["L"], strict=True)
        sums = [self._sum((a, self._x), (b, y), (after, missing)) for a, b, after in rows]
        self._x = [self._settled(total, m + i) for i, total in enumerate(sums)]
        return out

    def _valid_or(self, value: Any, otherwise: Any) -> Any:
        # this condition is also false if the value is NaN
        return value if abs(value) < LARGEST[self.law.numbers] else otherwise

    def _sum(self, *parts: tuple[list[Any], list[Any]]) -> Any:
        total = self._number(0)
        for row, values in parts:
            for factor, value in zip(row, values, strict=True):
                total = total + factor * value
        return total

    def _clipped(self, value: Any, low: float, high: float) -> Any:
        return low if value < low else high if value > high else value

    def _quantised(self, value: Any, step: Any) -> Any:
        if step == 0:
            return value
        count, large = value / step, self._number(NEAREST[self.law.numbers])
        if -large < count < large:
            count = (count + large) - large if count >= 0 else (count - large) + large
        return step * count

    def _semi_active(self, y: list[Any]) -> list[Any]:
        law, number = self.law, self._number
        assert law.coefficients is not None, "the law is semi-active"
        m = len(law.outputs)
        values = []
        for j in range(m):
            of = law.coefficients.alone(j)
            own = {one.name: number(getattr(of, one.name)) for one in fields(of) if one.name not in ("modes", "still")}
            damped, moved = ([number(one) for one in factors] for factors in of.modes)
            mine = LawCoefficients(**own, modes=(damped, moved), still=number(STILL[law.numbers]))
            values.append(number(LAWS[law.semi_active][0](mine, *y[: law.modes], *y[law.modes + j :: m])))
        return values


def random_inputs(law: ExportedLaw, count: int, seed: int) -> Iterator[list[float]]:
    """Yields `count` samples of random inputs, with magnitudes that are typical of roads, both signs and occasional zeros."""
    sizes = {"m": 0.05, "m/s": 0.5, "m/s²": 3.0, "m/s2": 3.0, "N": 1000.0, "rad": 0.05, "rad/s": 0.3, "rad/s²": 3.0}
    rng, scale = np.random.default_rng(seed), np.array([sizes.get(unit, 1.0) for unit in law.units])
    for row in rng.standard_normal((count, len(scale))) * scale:
        row[rng.random(len(row)) < 0.02] = 0.0
        if law.fixed is not None:
            yield [int(value) for value in np.clip(np.rint(row / law.fixed.seen), -law.fixed.largest - 1, law.fixed.largest)]
        else:
            yield [float(NUMBERS[law.numbers](value)) for value in row]
