"""Warnings about a control law: instability of the law itself, windup, direct feedback, and small margins of its ideal loop.

- A law is *unstable by itself* if its own states grow without measurements. A law that is unstable by itself has a pole to the
  right of the imaginary axis, or outside the unit circle.
- A law *winds up* if it is unstable by itself and has no anti-windup, and the vehicle file clips its forces (`actuator_force`
  or semi-active dampers). The states of a law that winds up grow, but the effect of the clipped forces on the measurements is
  bounded. Later measurements can therefore not bring the states back to zero. An integrator, which has a pole at 0, does not
  count as unstable, because its state grows no faster than the sum of its inputs.
- *Direct feedback* means that measurements contain the force of the law without delay, as accelerations do. Let H be the gain
  from the force, through the measurements that contain the force, back to the force. In the ideal loop, the force u satisfies u
  = H u + v, where v is the part of the force without direct feedback. With sampling or any delay, each computed force contains
  H times the previous force. The force grows if the spectral radius of H is 1 or more.
- The *margins* describe the ideal loop, cut at all actuators at once. The ideal loop is continuous, without `[limits]` and
  `[implementation]`; it contains actuator lag only if the design includes it. The gain margin is the factor closest to 1 that
  makes the loop unstable when it multiplies all forces. If H has a positive eigenvalue h, the gain margin is at most 1 / h. A
  gain margin is small if it is between 1 / `LEAST_GAIN` and `LEAST_GAIN`; a disk margin is small if it is below `LEAST_DISK`.
  (Skogestad, Postlethwaite 2005, section 2.4.3, require a gain margin above 2.) `sim.margins` also computes the margins of each
  actuator.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import as_name, by_text, rough
from models.document.field import Field
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import AnyController, Controller
from synth.controller.disk_margin import DiskMargin, disk_margin
from synth.controller.loop_of import loop_of
from synth.plant.state_space import StateSpace

LEAST_GAIN, LEAST_DISK = 2.0, 0.3
MANY = 3  # a sentence lists at most this many pairs of margins; if there are more, it lists only the smallest disk margins
FACTORS = np.geomspace(1.0, LEAST_GAIN, 42)[1:-1]  # factors by which the forces are multiplied, in steps of 1.7 %
GAIN = Field[float]("gain", float, ".3g", unit="dB")
TURN = Field[float]("angle", float, "{:.3g}°".format, 180 / math.pi)
SHARE = Field[float]("direct feedback", float, ".4g")
EXACT = 1e-9  # relative accuracy of the distance from 1 to the force factor at which the loop becomes unstable


@dataclass(frozen=True)
class LawMargins:
    """Stability of a law itself, and the stability margins of its ideal loop if they are small.

    Attributes:
        growth: growth rate of the fastest growing state of the law itself [1/s]; 0 if no state grows.
        winds_up: if the law winds up, description of the limit that clips the forces; else empty.
        gain: factor between 1 and `LEAST_GAIN` at which the loop becomes unstable; infinite if no such factor exists.
        gain_lower: factor between 1 / `LEAST_GAIN` and 1 at which the loop becomes unstable; 0 if no such factor exists.
        disk: symmetric disk margin from 0 to 2. None if the ideal loop is unstable, if the force depends on no measurement, or
            if the law is a passive element with inertance.
        direct_feedback: spectral radius of H, taking actuator lag into account; 0 if no measurement contains the force without
            delay.
    """

    growth: float
    winds_up: str
    gain: float
    gain_lower: float
    disk: float | None
    direct_feedback: float = 0.0

    @property
    def own_force(self) -> str:
        """Description of the direct feedback that makes sampling of the law impossible; empty if the law can be sampled."""
        if self.direct_feedback < 1:
            return ""
        times = SHARE.digits(self.direct_feedback)
        return f"the measurements contain {times} times the law's own force at once, which grows from sample to sample"

    @property
    def instability(self) -> str:
        """Description of the instability of the law itself and its windup; empty if the law is stable."""
        if not self.growth:
            return ""
        return f"unstable by itself (+{rough(self.growth)} 1/s)" + (f", winds up {self.winds_up}" if self.winds_up else "")

    @property
    def nearest(self) -> float | None:
        """The gain margin closest to 1, above or below; None if no gain margin is small."""
        nearest = self.gain if self.gain * self.gain_lower <= 1 else self.gain_lower
        return nearest if 0 < nearest < math.inf else None

    @property
    def pair(self) -> str:
        """Gain margin and disk margin as text; "-" replaces a gain margin that is not small."""
        return f"{'-' if self.nearest is None else _factor(self.nearest)}/{_disk(self.disk or 0.0)}"

    @property
    def small(self) -> str:
        """Small margins as text; empty if no margin is small."""
        texts = [f"gain margin {_factor(self.nearest)}"] if self.nearest is not None else []
        texts += [f"disk margin {_disk(self.disk)}"] if self.disk is not None and self.disk < LEAST_DISK else []
        return ", ".join(texts)

    @property
    def record(self) -> dict[str, Any]:
        """Margins as a JSON object, with None for gain margins that are not small and for margins that do not exist."""
        return {
            "winds_up": bool(self.winds_up),
            "gain_margin": self.gain if math.isfinite(self.gain) else None,
            "gain_margin_lower": self.gain_lower or None,
            "disk_margin": self.disk,
            "direct_feedback": self.direct_feedback or None,
        }


def law_margins(vehicle: Vehicle, controller: AnyController) -> LawMargins:
    """Returns the stability of a law itself, whether the law winds up, and the small margins of its ideal loop.

    Margins do not apply to a nonlinear law, so the result for a nonlinear law contains no small margin.
    """
    if controller.linear is False:
        return LawMargins(0.0, "", math.inf, 0.0, None)
    law = controller.law
    where = _clipped_forces(vehicle) if law.growth and law.anti_windup is None else ""
    gain, gain_lower, disk, direct = math.inf, 0.0, None, 0.0
    if law.acts and controller.certificate.stable:
        limits = replace(vehicle.limits, actuator_bandwidth=controller.hardware.bandwidth)
        built = loop_of(vehicle, controller)
        ideal = built if limits == vehicle.limits else loop_of(replace(vehicle, limits=limits), controller)
        direct, loop = built.direct_radius, ideal.cut(ideal.forces)
        if _growth(loop, np.ones(1))[0] < 0:  # rounding can make a loop at the stability limit look unstable
            gain = _first_unstable(loop, FACTORS, math.inf)
            gain_lower = _first_unstable(loop, 1 / FACTORS, 0.0)
            disk = None if direct and _is_element(vehicle, controller) else disk_margin(loop).size
    return LawMargins(law.growth, where, gain, gain_lower, disk, direct)


def law_fault(vehicle: Vehicle, controller: AnyController) -> str:
    """Returns the reason why a controller is never called the best; empty without a reason, or if the law is not linear."""
    if controller.growth:
        return "unstable by itself"
    margin = law_margins(vehicle, controller).disk
    return f"disk margin below {LEAST_DISK:g}" if margin is not None and margin < LEAST_DISK else ""


def warnings(margins: Mapping[str, LawMargins]) -> list[str]:
    """Returns a warning about laws that are unstable by themselves, and a warning about small margins of laws that are stable
    by themselves.
    """
    grow = {name: one for name, one in margins.items() if one.growth}
    clipped = {f", winding up {one.winds_up}": None for one in grow.values() if one.winds_up}
    rates = ", ".join(f"{as_name(name)} (+{rough(one.growth)} 1/s)" for name, one in grow.items())
    small = {name: one for name, one in margins.items() if one.small and name not in grow}
    pairs = by_text((name, one.pair) for name, one in small.items())
    listed = "; ".join(f"{names} {pair}" for pair, names in pairs.items())
    below = f"Small stability margins of the ideal loop (gain/disk): {listed}"
    if len(pairs) > MANY:
        disks = sorted((one.disk or 0.0, name) for name, one in small.items())
        some = ", ".join(f"{as_name(name)} {disk:#.2g}" for disk, name in disks[:MANY])
        below = f"Small disk margins: {some}, {len(disks) - MANY} more"
    texts = [f"Control laws that are unstable by themselves{''.join(clipped)}: {rates}"] if grow else []
    return [*texts, *([below] if small else [])]


def direct_feedback(margins: Mapping[str, LawMargins]) -> list[str]:
    """Returns a warning about laws that cannot be sampled because of their direct feedback."""
    times = [f"{as_name(name)} {SHARE.digits(one.direct_feedback)} times" for name, one in margins.items() if one.own_force]
    text = (
        f"WARNING: measurements contain the law's own force at once: {', '.join(times)}. With sampling or delay, the "
        "force grows from sample to sample; lower the gain on accelerations, or filter them."
    )
    return [text] if times else []


def _clipped_forces(vehicle: Vehicle) -> str:
    """Describes the limit that clips the forces of a law. The result is empty if the forces are not clipped."""
    if (force := vehicle.limits.actuator_force) is not None:
        return f"at {force / 1e3:g} kN" if force >= 1e3 else f"at {force:g} N"
    if (rate := vehicle.limits.force_rate) is not None:
        return f"at {rate / 1e3:g} kN/s"
    return "at the limits of the semi-active dampers" if vehicle.dampers else ""


def _is_element(vehicle: Vehicle, controller: Controller) -> bool:
    """Returns True if a law has the same effect as passive springs, dampers and inerters in the suspensions.

    The loop with a passive law is always stable.

    A passive law is u = -(K d + C d' + M d''), with the suspension deflections d and symmetric K and M; no part produces
    energy.
    """
    model, law, m = vehicle.linear_model, controller.law, len(vehicle.linear_model.inputs)
    places = {one.force: one.deflection for one in vehicle.kind.suspensions}
    deflections = [places.get(force, "") for force in model.inputs]
    if law.states or not {*deflections} <= {*model.outputs}:
        return False
    (C, D), rows = model.rows(controller.measured), [model.outputs.index(name) for name in deflections]
    speeds = model.C[rows] @ model.A
    none = np.zeros((m, m + model.Bw.shape[1]))
    motions = np.vstack(
        [np.hstack([model.C[rows], none]), np.hstack([speeds, none]), speeds @ np.hstack([model.A, model.B, model.Bw])]
    )
    read = law.D @ np.hstack([C, D, model.Dw[[model.outputs.index(name) for name in controller.measured]]])
    scale = np.abs(motions).max(axis=1, keepdims=True)
    shares = np.linalg.lstsq((motions / scale).T, -read.T)[0].T
    shares[np.abs(shares) <= EXACT * np.abs(read).max()] = 0.0
    if np.abs(shares @ (motions / scale) + read).max() > EXACT * np.abs(read).max():
        return False
    parts = np.split(shares / scale.T, 3, axis=1)
    takes = [np.linalg.eigvalsh(one + one.T).min() >= -EXACT * np.abs(one).max() for one in parts]
    return all(takes) and all(np.abs(one - one.T).max() <= EXACT * np.abs(one).max() for one in parts[::2])


def _growth(loop: StateSpace, factors: Array) -> Array:
    """Returns the growth rate of the loop [1/s] for each of several factors; all forces are multiplied by the factor.

    At some factor, the algebraic loop has no solution; the rate is infinite for all factors beyond this factor.
    """
    growth, direct = np.linalg.eigvals(loop.loop_matrix(factors)).real.max(axis=-1), np.linalg.eigvals(loop.D)
    limit = direct.real[np.abs(direct.imag) <= EXACT * np.abs(direct)].max(initial=0.0)
    return np.where(limit * factors >= 1, np.inf, growth)


def _first_unstable(loop: StateSpace, factors: Array, without: float) -> float:
    """Returns the factor closest to 1 at which the loop becomes unstable, or the argument `without` if the loop is stable for
    all factors.
    """
    unstable = np.flatnonzero(_growth(loop, factors) >= 0)
    if not len(unstable):
        return without
    first = int(unstable[0])
    stable, at = (float(factors[first - 1]) if first else 1.0), float(factors[first])
    while abs(at - stable) > EXACT * abs(at - 1):
        middle = (stable + at) / 2
        stable, at = (stable, middle) if _growth(loop, np.array([middle]))[0] >= 0 else (middle, at)
    return at


def _factor(factor: float) -> str:
    """Formats a gain factor, and the same factor in dB.

    The distance of the factor from 1 is given with two significant digits, and the factor has at most six decimals.
    """
    distance = abs(factor - 1)
    digits = f"{factor:.{min(6, max(2, 1 - math.floor(math.log10(distance))))}f}" if distance else "1"
    return f"{digits} ({decibels(factor)})"


def decibels(factor: float) -> str:
    """Formats a positive factor in dB, with the unit."""
    return GAIN.text(20 * math.log10(factor))


def _disk(size: float) -> str:
    """Formats a disk margin and the corresponding phase margin in degrees."""
    return f"{size:#.2g} ({TURN.digits(DiskMargin(size, math.nan).phase)})"
