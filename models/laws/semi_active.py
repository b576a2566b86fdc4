"""Built-in semi-active laws: the coefficient of a semi-active damper as a function of the motion of its suspension.

The body and the wheel at a suspension have the velocities z_s' and z_u'. The damper with the extension rate v = z_s' - z_u'
gives the force -c v. A law requests c. The damper clips its coefficient c to its limits and holds c constant until the next
sample. Delay and valve lag affect the coefficient c, but the damper force is always computed with the present velocity v. If a
law requests a force F of the whole damper, for example the force of a damper between body and sky, the coefficient is c = -F /
v. All functions in this file compute N simultaneous runs with m suspensions.

Source of the laws' names, and of laws without another source: Savaresi, Poussot-Vassal, Spelta, Sename,
Dugard, Semi-Active Suspension Control Design for Vehicles (2010), chapters 3 and 6.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.common.schema import SI, Choice, Section, keys
from models.laws.law import ControlLaw, Design, DriverKey, LawSource

STILL = 1e-150  # this velocity [m/s] replaces a velocity of 0, to avoid division by 0
SPRUNG, UNSPRUNG, ACCELERATION = "sprung_velocity", "unsprung_velocity", "sprung_acceleration"
DEFLECTION = "suspension_deflection"
MODES = ("heave_velocity", "pitch_rate", "roll_rate")
# Default crossover frequency [rad/s], equal to 1.9 Hz. At this frequency, which is slightly above the natural frequency of a
# car body, the laws skyhook and ADD are equally good
CROSSOVER = 12.0

Quantity = Any  # damping coefficients: an array for many dampers, or a number for one


@dataclass(frozen=True, eq=False)
class LawCoefficients:
    """Coefficients and geometry of N vehicles with m semi-active dampers each, or plain numbers for one damper.

    Attributes:
        c_min: smallest coefficient of the dampers [N s/m], shape (N, m); for measured characteristics, force divided by present
            velocity.
        c_max: largest coefficient of the dampers [N s/m], shape (N, m); for measured characteristics, force divided by present
            velocity.
        sky: coefficients of the dampers between body and sky [N s/m], shape (N, m).
        ground: coefficients of the dampers between wheel and ground [N s/m], shape (N, m).
        stiffness: stiffness of the suspension springs [N/m], shape (N, m).
        modes: factors from the velocities of the body's b modes to the velocities at the suspensions, as two tuples of b arrays
            of shape (N, m). The factors in the first tuple also include the sky damping of the mode, relative to `sky`.
        mix: weight of skyhook in a hybrid law, from 0 (only groundhook) to 1 (only skyhook), shape (N, m).
        crossover: frequency below which the mixed law is skyhook, and above which it is ADD [rad/s], shape (N, m).
        still: velocity that replaces a velocity of 0 [m/s].
    """

    c_min: Quantity
    c_max: Quantity
    sky: Quantity
    ground: Quantity
    stiffness: Quantity
    modes: tuple[Sequence[Quantity], Sequence[Quantity]]
    mix: Quantity
    crossover: Quantity
    still: float = STILL

    def alone(self, j: int) -> "LawCoefficients":
        """Returns the coefficients of damper j of the first vehicle as plain numbers."""
        damped, moved = ([float(factor[0, j]) for factor in factors] for factors in self.modes)
        others = {name: float(value[0, j]) for name, value in vars(self).items() if name not in ("modes", "still")}
        return replace(self, modes=(damped, moved), **others)


# Function that returns damping coefficients. The arguments are LawCoefficients, and then measurements of shape (N, m), or (N, 1)
# for a mode of the body
Law = Callable[..., Quantity]


def _choose(condition: Quantity, this: Quantity, that: Quantity) -> Quantity:
    """Works like `np.where`, for arrays and for plain numbers."""
    if isinstance(condition, np.ndarray):
        return np.where(condition, this, that)
    return this if condition else that


def _over(of: LawCoefficients, force: Quantity, v: Quantity) -> Quantity:
    """Returns the coefficient with which a damper gives a force [N] at a velocity, or at the velocity `still` if the velocity
    is 0.
    """
    return -force / _choose(v == 0, of.still, v)


def skyhook(of: LawCoefficients, body: Quantity, wheel: Quantity) -> Quantity:
    """Two-state skyhook: the damper is hard if it opposes the motion of the body, else soft (Karnopp, Crosby, Harwood 1974)."""
    return _choose(body * (body - wheel) > 0, of.c_max, of.c_min)


def skyhook_linear(of: LawCoefficients, body: Quantity, wheel: Quantity) -> Quantity:
    """Continuous skyhook: the force of a damper to the sky if the damper can give a force of this sign, else the soft setting."""
    v = body - wheel
    return _choose(body * v > 0, _over(of, -of.sky * body, v), of.c_min)


def groundhook(of: LawCoefficients, body: Quantity, wheel: Quantity) -> Quantity:
    """Two-state groundhook: the damper is hard if it opposes the wheel's motion, else soft (Valasek and others 1997)."""
    return _choose(-wheel * (body - wheel) > 0, of.c_max, of.c_min)


def hybrid(of: LawCoefficients, body: Quantity, wheel: Quantity) -> Quantity:
    """Weighted sum of the forces of a damper between body and sky and a damper between wheel and ground (Ahmadian 1997)."""
    v = body - wheel
    sky = _choose(body * v > 0, -of.sky * body, 0.0)
    ground = _choose(-wheel * v > 0, of.ground * wheel, 0.0)
    return _over(of, of.mix * sky + (1 - of.mix) * ground, v)


def acceleration_driven(of: LawCoefficients, body: Quantity, wheel: Quantity, acceleration: Quantity) -> Quantity:
    """ADD: the damper is hard if it opposes the acceleration of the body, else soft (Savaresi, Silani, Bittanti 2005)."""
    return _choose(acceleration * (body - wheel) > 0, of.c_max, of.c_min)


def power_driven(of: LawCoefficients, body: Quantity, wheel: Quantity, travel: Quantity) -> Quantity:
    """PDD: spring and damper together take energy out of the suspension (Morselli, Zanasi 2008).

    The damper is soft if its soft setting already dissipates the power that the spring releases. The damper is hard if even its
    hard setting does not dissipate the power that the spring releases. Otherwise, the damper dissipates exactly the power that
    the spring releases. If the velocity is zero and the spring is deflected, the coefficient is the mean of its smallest and
    largest values.
    """
    v = body - wheel
    spring = of.stiffness * travel
    soft, hard = spring * v + of.c_min * (v * v) >= 0, spring * v + of.c_max * (v * v) < 0
    coefficient = _choose(soft, of.c_min, _choose(hard, of.c_max, _over(of, spring, v)))
    return _choose((v == 0) & (spring != 0), (of.c_min + of.c_max) / 2, coefficient)


def skyhook_add(of: LawCoefficients, body: Quantity, wheel: Quantity, acceleration: Quantity) -> Quantity:
    """Mixed SH-ADD: skyhook below a crossover frequency of the body motion, ADD above it (Savaresi, Spelta 2007)."""
    slow = acceleration * acceleration <= of.crossover * of.crossover * (body * body)
    return _choose(slow, skyhook(of, body, wheel), acceleration_driven(of, body, wheel, acceleration))


def skyhook_modal(of: LawCoefficients, *modes_and_wheel: Quantity) -> Quantity:
    """Continuous skyhook for heave, pitch and roll: each mode has a damper to the sky, whose force the corners share."""
    damped = moved = 0.0
    # The terms are added in sequence, so that rounding errors do not depend on the number of runs
    for to_sky, share, speed in zip(*of.modes, modes_and_wheel, strict=False):
        damped += to_sky * speed
        moved += share * speed
    v = moved - modes_and_wheel[-1]
    return _choose(damped * v > 0, _over(of, -of.sky * damped, v), of.c_min)


BOTH = (SPRUNG, UNSPRUNG)
# Semi-active laws by name: the function of the law, its measurements at every suspension, and its other keys.
LAWS: dict[str, tuple[Law, tuple[str, ...], tuple[str, ...]]] = {
    "skyhook": (skyhook, BOTH, ()),
    "skyhook_linear": (skyhook_linear, BOTH, ("sky_damping",)),
    "groundhook": (groundhook, BOTH, ()),
    "hybrid": (hybrid, BOTH, ("sky_damping", "ground_damping", "mix")),
    "add": (acceleration_driven, (*BOTH, ACCELERATION), ()),
    "pdd": (power_driven, (*BOTH, DEFLECTION), ()),
    "skyhook_add": (skyhook_add, (*BOTH, ACCELERATION), ("crossover",)),
    "skyhook_modal": (skyhook_modal, (UNSPRUNG,), ("sky_damping", "heave_damping", "pitch_damping", "roll_damping")),
}
MODAL = {"heave_damping": MODES[0], "pitch_damping": MODES[1], "roll_damping": MODES[2]}


@dataclass(frozen=True)
class SemiActiveLaw(LawSource):
    """Reference to a built-in semi-active law, as in a vehicle file.

    Attributes:
        name: name of the law, a key of `LAWS`.
        numbers: parameters of the law that the vehicle file gives, each as key and value.
        endings: suffixes of the signal names, one for each suspension, in the order of the forces.
        modes: names of the velocity signals of body modes that the law measures; empty for laws that treat each corner
            separately.
    """

    linear, title = False, "a semi-active law"
    given = request = None

    name: str
    numbers: tuple[tuple[str, float], ...] = ()
    endings: tuple[str, ...] = ("",)
    modes: tuple[str, ...] = ()

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measured signals."""
        return (*self.modes, *(f"{quantity}{ending}" for quantity in LAWS[self.name][1] for ending in self.endings))

    @property
    def record(self) -> dict[str, Any]:
        """The law as keys of JSON and TOML."""
        return {"semi_active": self.name, **dict(self.numbers)}

    @property
    def values(self) -> dict[str, float | None]:
        """See `LawSource`."""
        return {key: dict(self.numbers).get(key) for key in LAWS[self.name][2]}

    def with_values(self, measured: tuple[str, ...], values: Mapping[str, float]) -> dict[str, Any]:
        """See `LawSource`."""
        return {**self.record, **values}

    def driver(
        self, name: str, measured: tuple[str, ...], design: Design[Any], read: Callable[[], str] | None = None
    ) -> "SemiActive":
        """See `LawSource`."""
        return SemiActive(name, self)

    @property
    def text(self) -> str:
        """The law as one line of text."""
        about = (LAWS[self.name][0].__doc__ or "").splitlines()[0].rstrip(".")
        return ", ".join([f"semi-active law {self.name}", *(f"{key} {value:g}" for key, value in self.numbers)]) + f" ({about})"

    def coefficients(self, y: Array, of: LawCoefficients) -> Array:
        """Returns the requested coefficients of the dampers [N s/m], shape (..., N, m).

        Args:
            y: measurements, shape (..., N, q).
            of: coefficients and geometry of the vehicles.
        """
        first, m = len(self.modes), len(self.endings)
        modes = (y[..., at : at + 1] for at in range(first))
        corners = (y[..., at : at + m] for at in range(first, len(self.measured), m))
        return LAWS[self.name][0](of, *modes, *corners)


@dataclass(frozen=True, eq=False)
class SemiActive(ControlLaw):
    """Controller with a built-in semi-active law. Linear analysis does not apply to a controller with a semi-active law.

    Attributes:
        name: name of the controller in the vehicle file.
        law: law that computes the requested coefficients of the dampers.
        code: exported code that computes the outputs of the controller in runs; None if the law itself computes them.
    """

    linear: ClassVar[Literal[False]] = False
    user_code: ClassVar[Literal[False]] = False

    name: str
    law: SemiActiveLaw
    code: Any = None

    @property
    def law_key(self) -> DriverKey:
        """See `ControlLaw`."""
        return ("semi_active", self.law.name, self.law.measured)

    @property
    def kind(self) -> str:
        """Type of the law with an article, for sentences."""
        return "a semi-active law"

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the q measured signals y."""
        return self.law.measured

    @property
    def text(self) -> str:
        """The law as one line of text."""
        return self.law.text

    @property
    def record(self) -> dict[str, Any]:
        """Name, signals, law and code of the controller as keys of JSON."""
        code = {"code": self.code.record} if self.code is not None else {}
        return {"name": self.name, "measured": list(self.measured), **self.law.record, **code}


DAMPING = "coefficient of a damper between body and sky"


@dataclass(frozen=True, kw_only=True)
class SemiActiveSection(Section):
    """Keys of a controller's section that contains a semi-active law."""

    semi_active: Annotated[str, Choice("name of a built-in semi-active law", (*LAWS,))] | None = None
    sky_damping: Annotated[float, SI("N s/m", DAMPING, 0.0)] | None = None
    ground_damping: Annotated[float, SI("N s/m", "coefficient of a damper between wheel and ground", 0.0)] | None = None
    mix: Annotated[float, SI("1", "weight of skyhook: 1 is skyhook alone, 0 groundhook alone", 0.0, 1.0)] | None = None
    crossover: Annotated[float, SI("rad/s", "frequency below which skyhook acts, and above which ADD acts")] | None = None
    heave_damping: Annotated[float, SI("N s/m", f"{DAMPING}, for heave alone", 0.0)] | None = None
    pitch_damping: Annotated[float, SI("N s/m", f"{DAMPING}, for pitch alone", 0.0)] | None = None
    roll_damping: Annotated[float, SI("N s/m", f"{DAMPING}, for roll alone", 0.0)] | None = None

    def semi_active_law(
        self, given: Sequence[str], outputs: Sequence[str], inputs: Sequence[str], endings: Mapping[str, str]
    ) -> SemiActiveLaw | None:
        """Returns the semi-active law; None for a section with a different type of law.

        Args:
            given: keys that the controller's section in the vehicle file contains.
            outputs: names of the output signals of the vehicle.
            inputs: names of the forces that controllers can apply to the vehicle.
            endings: suffix of the signal names at the suspension of each semi-active damper; the keys are the forces.

        Raises:
            InputError: a key belongs to a different law, or the vehicle lacks a signal or damper that the law needs.
        """
        if self.semi_active is None:
            if others := [key for key in given if key in keys(SemiActiveSection)]:
                raise InputError(
                    f'{others[0]} needs a semi-active law, but the section names none; give a law, as in semi_active = "skyhook"'
                )
            return None
        (law, _, own), what = LAWS[self.semi_active], f"semi_active = {self.semi_active!r}"
        if wrong := [key for key in given if key not in ("semi_active", *own)]:
            known = f"its keys are {list_names(own)}" if own else "this law has no keys"
            raise InputError(f"{what} has no key {wrong[0]!r} ({known}); omit {wrong[0]}")
        if absent := [force for force in inputs if force not in endings]:
            raise InputError(
                f'{what} needs semi-active dampers, but {absent[0]} has none; add [actuators] with kind = "damper", '
                "c_min and c_max"
            )
        modes = tuple(mode for mode in MODES if mode in outputs) if law is skyhook_modal else ()
        if law is skyhook_modal and not modes:
            raise InputError(
                f'{what} needs a body that pitches or rolls, which this vehicle does not have; give "skyhook_linear" instead'
            )
        for key, mode in MODAL.items():
            if key in given and mode not in modes:
                raise InputError(f"{key} has no effect, because this vehicle has no {mode}; omit {key}")
        numbers = tuple((key, getattr(self, key)) for key in own if key in given)
        law = SemiActiveLaw(self.semi_active, numbers, tuple(endings[force] for force in inputs), modes)
        if lacking := [signal for signal in law.measured if signal not in outputs]:
            raise InputError(
                f"{what} measures the signal {lacking[0]!r}, which this vehicle type does not have; choose a different law"
            )
        return law
