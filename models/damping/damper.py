"""`[actuators]` of a vehicle file: what sits in every suspension, an actuator that pushes or an adjustable damper.

An adjustable damper has a coefficient c from c_min to c_max that a valve sets, and gives -c v, with v the velocity at which its
suspension is stretched. The linear model (28) has the nominal coefficient c_s in it, so what such a damper gives beyond that is

    u = -(c - c_s) v.

A controller that asks for a force u* beyond the nominal damper's gets the coefficient that would give it, as far as there is one:

    c = clip(c_s - u* / v, c_min, c_max),

set at the controller's sample from the velocity then, and held until the next. Where v is 0 and u* is not, v is taken for one
that is about to be below it; where both are 0 the damper is the nominal one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted

KINDS = ("force", "damper")
KEYS = ("kind", "c_min", "c_max", "bandwidth")
SMALLEST, LARGEST = 1e-6, 1e12  # SI; beyond these a number is a slip of the pen
COEFFICIENT, MISSING = "damping", "missing_force"  # begin the names of a damper's signals
STILL = 1e-150  # m/s; a velocity of 0 counts as this one, inwards


@dataclass(frozen=True)
class Damper:
    """An adjustable damper.

    Attributes:
        c_min, c_max: its smallest and its largest coefficient [N s/m].
        bandwidth: corner frequency of its valve, a first-order lag from the coefficient that is set to the one that acts [rad/s];
            None for one that acts at once.
    """

    c_min: float
    c_max: float
    bandwidth: float | None = None

    @property
    def words(self) -> str:
        """It in a phrase."""
        lag = "" if self.bandwidth is None else f", whose valve lags from {self.bandwidth:g} rad/s on"
        return f"an adjustable damper of {self.c_min:g} to {self.c_max:g} N s/m{lag}"


def read_actuators(
    section: Mapping[str, Any], corners: Mapping[str, str], limited: Sequence[str], curves: Sequence[str]
) -> dict[str, Damper]:
    """`[actuators]`, checked: the adjustable dampers, by the force that each stands for.

    Args:
        section: as it was read: keys of all of them, and sections of single ones by the ending of their force's name.
        corners: of every force of a suspension, that ending, with its underscore.
        limited: what `[limits]` says of actuators.
        curves: the parameters that have one.

    Raises:
        InputError: a key that is unknown, a value that is not allowed, or something that goes with actuators that push alone.
    """
    endings = {ending.removeprefix("_"): force for force, ending in corners.items() if ending}
    for name, value in section.items():
        if isinstance(value, Mapping) and name not in endings:
            known = f"sections {listing(endings)}" if endings else "no sections, for there is one suspension"
            raise InputError(f"[actuators.{name}] is no suspension of this vehicle; it has {known}")
        if not isinstance(value, Mapping) and name not in KEYS:
            raise InputError(f"[actuators] unknown key {name!r}; known: {listing((*KEYS, *endings))}")
    common = {name: value for name, value in section.items() if not isinstance(value, Mapping)}
    own = {endings[name]: (f"[actuators.{name}]", value) for name, value in section.items() if isinstance(value, Mapping)}
    for where, value in own.values():
        for name in value:
            if name not in KEYS:
                raise InputError(f"{where} unknown key {name!r}; known: {listing(KEYS)}")
    made = {force: _damper(*_merged(common, own.get(force))) for force in corners}
    if not made and section:
        raise InputError("[actuators]: this kind of vehicle has no suspension with a force; leave the section out")
    found = {force: damper for force, damper in made.items() if damper is not None}
    if found and limited:
        raise InputError(
            f"[limits] {limited[0]} is of actuators that push, and [actuators] has adjustable dampers, which c_min, c_max and "
            "bandwidth limit; leave it out"
        )
    if found and curves:
        raise InputError(
            f"[curves] {curves[0]} and the adjustable dampers of [actuators] are not run together; leave one of them out"
        )
    return found


def _merged(common: Mapping[str, Any], own: tuple[str, Mapping[str, Any]] | None) -> tuple[str, dict[str, Any]]:
    """Where one actuator is spoken of, for messages, and all that is said of it."""
    if own is None:
        return "[actuators]", dict(common)
    where, section = own
    usual = {} if section.get("kind") == KINDS[0] else common
    return where, {**usual, **section}


def _damper(where: str, given: Mapping[str, Any]) -> Damper | None:
    kind = given.get("kind", KINDS[0])
    if kind not in KINDS:
        raise InputError(f"{where} kind = {quoted(kind)} is not known; known: {listing(KINDS)}")
    numbers = {name: given[name] for name in KEYS[1:] if name in given}
    if kind == KINDS[0]:
        if numbers:
            raise InputError(
                f'{where} has {next(iter(numbers))} and no kind = "damper", of which alone that is; an actuator\'s largest force '
                "and its lag stand in [limits]"
            )
        return None
    for name, value in numbers.items():
        smallest, unit = (0.0, "N s/m") if name == "c_min" else (SMALLEST, "rad/s" if name == "bandwidth" else "N s/m")
        real = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not real or not smallest <= value <= LARGEST:
            allowed = f"a number from {smallest:g} to {LARGEST:g} {unit}"
            raise InputError(f"{where} {name} = {quoted(value)} is not allowed; give {allowed}")
    if absent := [name for name in ("c_min", "c_max") if name not in numbers]:
        raise InputError(f"{where} {absent[0]} is missing; an adjustable damper has c_min and c_max [N s/m]")
    if not numbers["c_min"] < numbers["c_max"]:
        raise InputError(
            f"{where} c_min = {numbers['c_min']:g} N s/m is not below c_max = {numbers['c_max']:g} N s/m; give a smaller "
            "c_min, or a larger c_max"
        )
    return Damper(**{name: float(value) for name, value in numbers.items()})


@dataclass(frozen=True)
class Adjustable:
    """An adjustable damper in its vehicle.

    Attributes:
        force: the input that it stands for, what it gives beyond the nominal damper.
        ending: of the names of what lies at its suspension.
        damper: itself.
        nominal: the coefficient of the linear model [N s/m].
    """

    force: str
    ending: str
    damper: Damper
    nominal: float

    @property
    def coefficient(self) -> str:
        """The signal of the coefficient that acts."""
        return f"{COEFFICIENT}{self.ending}"

    @property
    def missing(self) -> str:
        """The signal of the force that was asked for and that it does not give."""
        return f"{MISSING}{self.ending}"


class Suspension(Protocol):
    """What is asked of a suspension here; see `models.kind.Suspension`."""

    @property
    def force(self) -> str:
        """The input that pushes along it; empty where none does."""
        ...

    @property
    def ending(self) -> str:
        """Of the names of what lies at its corner."""
        ...

    @property
    def damping(self) -> str:
        """The parameter of its damper; empty where there is none."""
        ...


def adjustable(
    dampers: Mapping[str, Damper], suspensions: Sequence[Suspension], parameters: Mapping[str, float]
) -> tuple[Adjustable, ...]:
    """Adjustable dampers in their vehicle.

    Args:
        dampers: by force.
        suspensions: of the vehicle, in the order of its forces.
        parameters: of the vehicle, by name.

    Raises:
        InputError: a suspension has no nominal damper, or none that its adjustable one can be.
    """
    found = []
    for one in suspensions:
        if one.force not in dampers:
            continue
        damper = dampers[one.force]
        if not one.damping:
            raise InputError(
                f"[actuators] the kind does not say which parameter is the damper at {one.force}; let its Suspension say it"
            )
        nominal = parameters[one.damping]
        if not damper.c_min <= nominal <= damper.c_max:
            raise InputError(
                f"{one.damping} = {nominal:g} N s/m, which acts where no force is asked for, is not among the "
                f"{damper.c_min:g} to {damper.c_max:g} N s/m of [actuators]; widen these or move that"
            )
        found.append(Adjustable(one.force, one.ending, damper, nominal))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Range:
    """How far coefficients can be from their nominal ones, of N runs with m actuators each.

    An actuator that pushes counts among them: its suspension closes at 1, and it has no ends, so that what it is to be is its
    force.

    Attributes:
        low, high: the smallest and the largest coefficient beyond the nominal one [N s/m], shape (N, m).
        adjustable: which of the actuators are adjustable dampers, of every run the same, shape (m,).
    """

    low: Array
    high: Array
    adjustable: Array

    def commands(self, asked: Array, which: Array | slice = slice(None)) -> Array:
        """What is asked of every actuator, and which forces that leaves out, shape (..., N, 2 m).

        The first half are coefficients beyond the nominal ones [N s/m], and forces of actuators that push [N]; the second half
        what is missing of the forces that were asked for [N].

        Args:
            asked: those forces, and how fast each suspension closes, see `closing`, shape (..., N, 2 m).
            which: of the N.
        """
        m = self.low.shape[1]
        forces, closing = asked[..., :m], asked[..., m:]
        beyond = np.minimum(np.maximum(forces / closing, self.low[which]), self.high[which])
        return np.concatenate([beyond, forces - beyond * closing], axis=-1)

    def set_to(self, asked: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """The same where coefficients are asked for, shape (..., N, 2 m).

        Args:
            asked: coefficients beyond the nominal ones [N s/m], shape (..., N, m).
            closing: how fast each suspension closes [m/s], shape (..., N, m).
            which: of the N.
        """
        beyond = np.minimum(np.maximum(asked, self.low[which]), self.high[which])
        return np.concatenate([beyond, (asked - beyond) * closing], axis=-1)

    @property
    def at_rest(self) -> Array:
        """What to add to -v, so that there is no 0 among what `commands` takes, shape (m,)."""
        return np.where(self.adjustable, STILL, 1.0)


def range_of(vehicles: Sequence[Sequence[Adjustable]], forces: Sequence[str]) -> Range:
    """What the actuators of N vehicles can be.

    Args:
        vehicles: the adjustable dampers of each.
        forces: of each, m of them.
    """
    low, high = np.full((len(vehicles), len(forces)), -np.inf), np.full((len(vehicles), len(forces)), np.inf)
    for i, some in enumerate(vehicles):
        for one in some:
            j = forces.index(one.force)
            low[i, j], high[i, j] = one.damper.c_min - one.nominal, one.damper.c_max - one.nominal
    adjustable = np.isfinite(low)
    assert np.all(adjustable == adjustable[0]), "vehicles side by side have their dampers at the same places"
    return Range(low, high, adjustable[0])
