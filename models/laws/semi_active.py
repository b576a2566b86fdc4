"""The semi-active laws that ship: what coefficient an adjustable damper is to have, from what its suspension does.

With z_s' and z_u' the velocities of body and wheel at a suspension, and v = z_s' - z_u', at which it is stretched, a damper gives
-c v. What a law asks for is c; the damper gives what it can of it, until the next sample. Of laws that ask for a force F of the
whole damper, as of a damper between body and sky, that is c = -F / v. Everything is of N runs side by side, and of m suspensions;
or of one suspension of a run alone, in plain numbers: between two steps of that a single call of numpy costs a tenth of a step.

Source of the names, and of the laws where none is said: Savaresi, Poussot-Vassal, Spelta, Sename, Dugard, Semi-Active Suspension
Control Design for Vehicles (2010), chapters 3 and 6.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted

STILL = 1e-150  # m/s; a velocity of 0 counts as this one, inwards
SPRUNG, UNSPRUNG, ACCELERATION = "sprung_velocity", "unsprung_velocity", "sprung_acceleration"
DEFLECTION = "suspension_deflection"
MODES = ("heave_velocity", "pitch_rate", "roll_rate")
CROSSOVER = 12.0  # rad/s, 1.9 Hz: a little above a car's body on its springs, where skyhook and ADD are alike good
SMALLEST, LARGEST = 1e-6, 1e12

Quantity = Any  # an array of many, or a number of one


@dataclass(frozen=True, eq=False)
class Numbers:
    """What a law knows of N vehicles with m adjustable dampers each, or, in plain numbers, of one damper of one of them.

    Attributes:
        c_min, c_max: of the dampers [N s/m], shape (N, m); of measured curves, force over velocity at the velocities there are.
        sky, ground: coefficients of the dampers between body and sky, and wheel and ground [N s/m], shape (N, m).
        stiffness: of the suspensions' springs [N/m], shape (N, m).
        modes: velocities of the body at the suspensions from those of its b modes, each as damped to the sky as it is to be over
            `sky`, and as they are, shapes (b, N, m).
        mix: of hybrid: 1 is skyhook alone, 0 groundhook.
        crossover: of the mixed law: slower than that it is skyhook, faster ADD [rad/s].
    """

    c_min: Quantity
    c_max: Quantity
    sky: Quantity
    ground: Quantity
    stiffness: Quantity
    modes: tuple[Sequence[Quantity], Sequence[Quantity]]
    mix: float
    crossover: float

    def some(self, which: Array | slice) -> "Numbers":
        """Of some of the vehicles."""
        return self._of_each(lambda quantity: quantity[which])

    def alone(self, j: int) -> "Numbers":
        """Of damper j of the first vehicle, in plain numbers."""
        return self._of_each(lambda quantity: float(quantity[0, j]))

    def _of_each(self, taken: Callable[[Quantity], Quantity]) -> "Numbers":
        """With something taken of each quantity."""
        damped, moved = ([taken(one) for one in each] for each in self.modes)
        return Numbers(
            taken(self.c_min),
            taken(self.c_max),
            taken(self.sky),
            taken(self.ground),
            taken(self.stiffness),
            (damped, moved),
            self.mix,
            self.crossover,
        )


Law = Callable[..., Quantity]  # of the numbers, and of what is measured, shape (N, m) each, of a body's mode (N, 1)


def _choose(condition: Quantity, this: Quantity, that: Quantity) -> Quantity:
    """`np.where`, of plain numbers, too."""
    if isinstance(condition, np.ndarray):
        return np.where(condition, this, that)
    return this if condition else that


def _over(force: Quantity, v: Quantity) -> Quantity:
    """The coefficient of a damper that gives a force [N] at a velocity, or next to it where that is 0."""
    return -force / _choose(v == 0, STILL, v)


def skyhook(of: Numbers, body: Quantity, wheel: Quantity) -> Quantity:
    """Two-state skyhook: hard where a damper moves as the body does, else soft (Karnopp, Crosby, Harwood 1974)."""
    return _choose(body * (body - wheel) > 0, of.c_max, of.c_min)


def skyhook_linear(of: Numbers, body: Quantity, wheel: Quantity) -> Quantity:
    """Continuous skyhook: the force of a damper to the sky, where the damper's own has its sign, else soft."""
    v = body - wheel
    return _choose(body * v > 0, _over(-of.sky * body, v), of.c_min)


def groundhook(of: Numbers, body: Quantity, wheel: Quantity) -> Quantity:
    """Two-state groundhook: hard where a damper moves against the wheel, else soft (Valasek, Novak, Sika, Vaculin 1997)."""
    return _choose(-wheel * (body - wheel) > 0, of.c_max, of.c_min)


def hybrid(of: Numbers, body: Quantity, wheel: Quantity) -> Quantity:
    """The forces of a damper to the sky and one to the ground, each where it can be had, in shares (Ahmadian 1997)."""
    v = body - wheel
    sky = _choose(body * v > 0, -of.sky * body, 0.0)
    ground = _choose(-wheel * v > 0, of.ground * wheel, 0.0)
    return _over(of.mix * sky + (1 - of.mix) * ground, v)


def acceleration_driven(of: Numbers, body: Quantity, wheel: Quantity, acceleration: Quantity) -> Quantity:
    """ADD: hard where a damper moves as the body accelerates, else soft (Savaresi, Silani, Bittanti 2005)."""
    return _choose(acceleration * (body - wheel) > 0, of.c_max, of.c_min)


def power_driven(of: Numbers, body: Quantity, wheel: Quantity, travel: Quantity) -> Quantity:
    """PDD: so that spring and damper together take energy out of the suspension (Morselli, Zanasi 2008).

    Soft where the soft damper takes all that the spring gives, hard where not even the hard one does; between them as much as the
    spring; and midway where the damper stands still, its spring stretched.
    """
    v = body - wheel
    spring = of.stiffness * travel
    soft, hard = spring * v + of.c_min * (v * v) >= 0, spring * v + of.c_max * (v * v) < 0
    found = _choose(soft, of.c_min, _choose(hard, of.c_max, _over(spring, v)))
    return _choose((v == 0) & (spring != 0), (of.c_min + of.c_max) / 2, found)


def skyhook_add(of: Numbers, body: Quantity, wheel: Quantity, acceleration: Quantity) -> Quantity:
    """Mixed SH-ADD: skyhook where the body moves slower than a frequency, ADD where faster (Savaresi, Spelta 2007)."""
    slow = acceleration * acceleration <= of.crossover**2 * (body * body)
    return _choose(slow, skyhook(of, body, wheel), acceleration_driven(of, body, wheel, acceleration))


def skyhook_modal(of: Numbers, *modes_and_wheel: Quantity) -> Quantity:
    """Continuous skyhook of the body's modes: heave, pitch and roll have a damper to the sky each, shared among the corners."""
    damped = moved = 0.0
    for to_sky, share, speed in zip(*of.modes, modes_and_wheel, strict=False):  # one by one: the same in whatever company
        damped += to_sky * speed
        moved += share * speed
    v = moved - modes_and_wheel[-1]
    return _choose(damped * v > 0, _over(-of.sky * damped, v), of.c_min)


BOTH = (SPRUNG, UNSPRUNG)
# By name: the law, what it measures at every suspension, and the keys that it has beside its name.
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
KEYS = ("semi_active", "sky_damping", "ground_damping", "mix", "crossover", "heave_damping", "pitch_damping", "roll_damping")
UNITS = {"mix": "", "crossover": " rad/s"}
MODAL = {"heave_damping": MODES[0], "pitch_damping": MODES[1], "roll_damping": MODES[2]}


@dataclass(frozen=True)
class SemiActiveLaw:
    """A law that ships, as a vehicle file asks for it.

    Attributes:
        name: of `LAWS`.
        numbers: its keys that the file gives.
        endings: of the names at the suspensions, in the order of the forces.
        modes: of the body that it measures; empty of laws that work corner by corner.
    """

    name: str
    numbers: tuple[tuple[str, float], ...] = ()
    endings: tuple[str, ...] = ("",)
    modes: tuple[str, ...] = ()

    @property
    def measured(self) -> tuple[str, ...]:
        """The signals that it measures."""
        return (*self.modes, *(f"{quantity}{ending}" for quantity in LAWS[self.name][1] for ending in self.endings))

    @property
    def record(self) -> dict[str, Any]:
        """It as JSON and TOML hold it."""
        return {"semi_active": self.name, **dict(self.numbers)}

    @property
    def text(self) -> str:
        """It on one line."""
        about = (LAWS[self.name][0].__doc__ or "").splitlines()[0].rstrip(".")
        return ", ".join([f"semi-active law {self.name}", *(f"{key} {value:g}" for key, value in self.numbers)]) + f" ({about})"

    def coefficients(self, y: Array, of: Numbers) -> Array:
        """What it asks for [N s/m], shape (..., N, m).

        Args:
            y: what it measures, shape (..., N, q).
            of: the vehicles.
        """
        first, m = len(self.modes), len(self.endings)
        modes = (y[..., at : at + 1] for at in range(first))
        corners = (y[..., at : at + m] for at in range(first, len(self.measured), m))
        return LAWS[self.name][0](of, *modes, *corners)

    def alone(self, of: Numbers, places: Sequence[int]) -> Callable[[Sequence[float]], list[float]]:
        """The same of the first of the vehicles, in plain numbers: m of them from a list of numbers.

        Args:
            of: the vehicles.
            places: where in that list stands what it measures, q of them.
        """
        law, first, m = LAWS[self.name][0], len(self.modes), len(self.endings)
        corners = [(itemgetter(*places[:first], *places[first + j :: m]), of.alone(j)) for j in range(m)]

        def coefficients(seen: Sequence[float]) -> list[float]:
            return [law(numbers, *mine(seen)) for mine, numbers in corners]

        return coefficients


@dataclass(frozen=True, eq=False)
class SemiActive:
    """A controller that is a law that ships; no linear claim is made of it.

    Attributes:
        name: as asked for.
        law: which.
    """

    name: str
    law: SemiActiveLaw
    kind: ClassVar[str] = "a semi-active law"

    @property
    def states(self) -> int:
        """None: its law is not linear."""
        return 0

    @property
    def measured(self) -> tuple[str, ...]:
        """The signals y, q of them."""
        return self.law.measured

    @property
    def text(self) -> str:
        """The law on one line."""
        return self.law.text

    @property
    def record(self) -> dict[str, Any]:
        """Name, signals and law as JSON has them."""
        return {"name": self.name, "measured": list(self.measured), **self.law.record}


def read_semi_active(
    where: str, entry: Mapping[str, Any], outputs: Sequence[str], inputs: Sequence[str], endings: Mapping[str, str]
) -> SemiActiveLaw | None:
    """The law that an entry of `[controllers]` asks for by name; None where it asks for none.

    Args:
        where: the entry, for messages.
        entry: as it was read.
        outputs: signals of the vehicle.
        inputs: its forces.
        endings: of the names at every suspension that has an adjustable damper, by force.

    Raises:
        InputError: something of it is unknown or not allowed, or the vehicle is none for it.
    """
    name = entry.get("semi_active")
    others = [key for key in entry if key in KEYS[1:]]
    if "semi_active" not in entry:
        if others:
            raise InputError(f'{where} {others[0]} is of a semi-active law; give one, as in semi_active = "skyhook"')
        return None
    if not isinstance(name, str) or name not in LAWS:
        raise InputError(f"{where} semi_active = {quoted(name)} is not known; known: {listing(LAWS)}")
    law, _, keys = LAWS[name]
    for key in entry:
        if key != "semi_active" and key not in keys:
            known = f"beside its name it has {listing(keys)}" if keys else "it has nothing beside its name"
            raise InputError(f"{where} semi_active = {quoted(name)} has no key {key!r}; {known}, and measures what it needs")
    if absent := [force for force in inputs if force not in endings]:
        raise InputError(
            f"{where} semi_active = {quoted(name)} sets adjustable dampers, and {absent[0]} is of none; give [actuators] "
            'kind = "damper", c_min and c_max'
        )
    numbers = tuple((key, _number(where, key, entry[key])) for key in keys if key in entry)
    modes = tuple(mode for mode in MODES if mode in outputs) if law is skyhook_modal else ()
    if law is skyhook_modal and not modes:
        raise InputError(f'{where} semi_active = {quoted(name)} is of a body that pitches or rolls; give "skyhook_linear"')
    for key, mode in MODAL.items():
        if key in entry and mode not in modes:
            raise InputError(f"{where} {key}: this vehicle has no {mode}; leave it out")
    found = SemiActiveLaw(name, numbers, tuple(endings[force] for force in inputs), modes)
    if lacking := [signal for signal in found.measured if signal not in outputs]:
        raise InputError(f"{where} semi_active = {quoted(name)} measures {lacking[0]!r}, which this kind of vehicle has not")
    return found


def _number(where: str, key: str, value: Any) -> float:
    smallest, largest = (0.0, 1.0) if key == "mix" else (SMALLEST, LARGEST) if key == "crossover" else (0.0, LARGEST)
    real = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not real or not smallest <= value <= largest:
        unit = UNITS.get(key, " N s/m")
        raise InputError(f"{where} {key} = {quoted(value)} is not allowed; give a number from {smallest:g} to {largest:g}{unit}")
    return float(value)
