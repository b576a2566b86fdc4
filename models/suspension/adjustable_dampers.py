"""Adjustable dampers in their vehicle, and what stands beside them there.

A curve of `[curves]` for the damper of a suspension that is adjustable stands beside it: what it has beyond its line at rest acts
whatever is set, as the friction of a strut does. The adjustable damper itself is in the place of the line.

With c_s the nominal coefficient and d that which is set beyond it, all of it pulls with

    c_s v + g(v) + d h(v),

where h is v but for a damper of two curves (`models.suspension.damper`), and g what its nominal setting has beyond its line,
and what stands beside it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.suspension.curve import Curve
from models.suspension.damper import Damper
from models.suspension.fitted_curves import Fitted

COEFFICIENT, MISSING = "damping", "missing_force"  # begin the names of a damper's signals
ROUNDING = 1e-9  # of what curve and line pull with


@dataclass(frozen=True)
class Adjustable:
    """An adjustable damper in its vehicle.

    Attributes:
        force: the input that it stands for, what it gives beyond the nominal damper.
        ending: of the names of what lies at its suspension.
        damper: itself.
        nominal: the coefficient of the linear model [N s/m].
        standing: the curve c_s v + g(v); None where g is 0.
    """

    force: str
    ending: str
    damper: Damper
    nominal: float
    standing: Curve | None = None

    @property
    def coefficient(self) -> str:
        """The signal of the coefficient that acts."""
        return f"{COEFFICIENT}{self.ending}"

    @property
    def missing(self) -> str:
        """The signal of the force that was asked for and that it does not give."""
        return f"{MISSING}{self.ending}"

    @property
    def low(self) -> float:
        """The least coefficient beyond the nominal one [N s/m]."""
        return self.damper.c_min - self.nominal

    @property
    def high(self) -> float:
        """The largest."""
        return self.damper.c_max - self.nominal

    @property
    def steepest(self) -> float:
        """The steepest slope of the damper at any setting [N s/m], without what stands beside it."""
        pair = self.damper.pair
        return self.damper.c_max if pair is None else float(max(pair.soft.slopes.max(), pair.hard.slopes.max()))

    def shape(self, v: Array) -> Array:
        """h [m/s] at velocities [m/s], shape (...)."""
        return np.asarray(v) if self.damper.pair is None else self.damper.pair.shape(v)

    def pull(self, v: Array, beyond: Array | float) -> Array:
        """What it pulls with at velocities and coefficients beyond the nominal one [N], shape (...)."""
        still = self.nominal * np.asarray(v) if self.standing is None else self.standing(v)
        return still + beyond * self.shape(v)

    @property
    def base(self) -> Curve | None:
        """The curve that acts at every setting, beside (c - c_s) l v and (c - c_min) (h(v) - l v), l v being its line at rest.

        None for none.
        """
        if self.standing is None or self.damper.pair is None:
            return self.standing
        pair, x = self.damper.pair, np.union1d(self.standing.x, self.damper.pair.knots)
        bent = self.standing.pieces.force(x) + self.low * (pair.shape(x) - pair.line * x)
        return replace(self.standing, x=x, force=self.nominal * x + bent)


class Suspension(Protocol):
    """What is asked of a suspension here; see `models.kinds.kind.Suspension`."""

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
    dampers: Mapping[str, Damper],
    suspensions: Sequence[Suspension],
    parameters: Mapping[str, float],
    curves: Mapping[str, Curve],
) -> tuple[Adjustable, ...]:
    """Adjustable dampers in their vehicle.

    Args:
        dampers: by force.
        suspensions: of the vehicle, in the order of its forces.
        parameters: of the vehicle, by name.
        curves: that stand in for some of these.

    Raises:
        InputError: a suspension has no nominal damper, or none that its adjustable one can be, or its curve feeds energy in.
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
        found.append(Adjustable(one.force, one.ending, damper, nominal, _standing(damper, nominal, curves.get(one.damping))))
        _check_takes(one.damping, found[-1])
        pairs = [dampers[other.force].pair for other in suspensions if other.damping == one.damping and other.force in dampers]
        if damper.pair is not None and not all(damper.pair.same(pair) for pair in pairs):
            raise InputError(
                f"[actuators] suspensions that share {one.damping} have dampers of other curves; give one pair of c_min and "
                "c_max to all of them"
            )
    return tuple(found)


def _standing(damper: Damper, nominal: float, beside: Curve | None) -> Curve | None:
    """See `Adjustable.standing`; of what lies beside, a curve of `[curves]`, the pieces count, whatever its line."""
    parts = [(1.0, beside.x, beside.pieces)] if beside is not None else []
    if damper.pair is not None:
        share, pair = (nominal - damper.c_min) / (damper.c_max - damper.c_min), damper.pair
        parts += [(1 - share, pair.soft.x, pair.soft.pieces), (share, pair.hard.x, pair.hard.pieces)]
    if not parts:
        return None
    x = np.unique(np.concatenate([points for _, points, _ in parts]))
    bent = sum((weight * pieces.force(x) for weight, _, pieces in parts), np.zeros_like(x))
    return Curve(x, nominal * x + bent, nominal, "the nominal damper, with what stands beside it")


def _check_takes(parameter: str, one: Adjustable) -> None:
    """Whether a damper at its softest takes energy with what stands beside it, at every velocity; at others it takes more.

    Raises:
        InputError: it does not.
    """
    if one.standing is None:
        return
    x = one.standing.x
    pull, far = one.pull(x, one.low), 2 * x[[0, -1]]
    on = (one.pull(far, one.low) - pull[[0, -1]]) / x[[0, -1]]
    feeding = np.flatnonzero(pull * np.sign(x) < -ROUNDING * one.standing.range)
    where = [f"at {x[i]:g} m/s" for i in feeding[:1]]
    where += [f"beyond {x[end]:g} m/s, as it goes on from there" for end in (0, -1) if on[end] < -ROUNDING * one.steepest]
    if where:
        raise InputError(
            f"[curves] {parameter} lies beside an adjustable damper, at every setting with what it has beyond its line at rest, "
            f"and so feeds energy in {where[0]} at the softest one; give its line and friction alone in [curves], and measured "
            "limits of the damper as curves c_min and c_max of [actuators]"
        )


def check_measured(name: str, measured: Sequence[str], dampers: Mapping[str, Damper]) -> None:
    """Whether a controller measures no force of a damper with curves: in MuJoCo that is of several actuators, and none's.

    Raises:
        InputError: it does.
    """
    for force in measured:
        if force in dampers and dampers[force].pair is not None:
            raise InputError(
                f"[controllers.{name}] measures {force}, and no sensor tells it of a damper with curves c_min and c_max; measure "
                "suspension_velocity, from which it follows, or give numbers"
            )


def softest(curves: Sequence[Fitted], dampers: Sequence[Adjustable], pushed: Callable[[str], str]) -> tuple[Fitted, ...]:
    """Curves of suspensions with what acts at every setting (`Adjustable.base`) for the dampers that are adjustable.

    Args:
        curves: as fitted.
        dampers: of the vehicle.
        pushed: from a force to the deflection of its suspension.
    """
    bases = {pushed(one.force): one.base for one in dampers}
    found = []
    for one in curves:
        base = bases.get(one.deflection) if one.damps else None
        found.append(one if base is None else replace(one, curve=base))
    return tuple(found)
