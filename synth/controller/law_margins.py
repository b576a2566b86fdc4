"""Warnings about a law: unstable by itself, windup, direct feedback, and small stability margins of its ideal loop.

- A law is *unstable by itself* if its own states grow without measurements: a pole right of the imaginary axis, or outside the
  unit circle.
- A law *winds up* if it is unstable by itself, the vehicle file clips its forces (`actuator_force` or adjustable dampers), and it
  has no anti-windup. Its states grow, but its clipped forces and their effect on the measurements are bounded, so that no later
  measurement brings the states back. An integrator has a pole at 0 and does not count: its states grow no faster than the
  measurements.
- *Direct feedback* is a force in its own measurements at once, as accelerations contain it: their share H of the force. The ideal
  loop solves u = H u + ..., but once it is sampled, or late by any time, each computed force contains H times the one before, and
  grows if the spectral radius of H is 1 or more.
- The *margins* are those of the ideal loop, cut at all actuators together: continuous, without `[limits]` and `[implementation]`,
  with the actuators' lag only if the design has it. The gain margin is the factor on all forces, nearest to 1, at which the loop
  is unstable, at most 1 / h for a positive eigenvalue h of H. A margin is small below `LEAST_GAIN`, or its inverse, or below
  `LEAST_DISK`. (Skogestad, Postlethwaite 2005, section 2.4.3, require a gain margin above 2.) `sim.margins` measures the margins
  of each actuator, too.
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
MANY = 3  # pairs of margins that a sentence lists in full; of more, the smallest disk margins
FACTORS = np.geomspace(1.0, LEAST_GAIN, 42)[1:-1]  # steps of 1.7 %
GAIN = Field[float]("gain", float, ".3g", unit="dB")
TURN = Field[float]("angle", float, "{:.3g}°".format, 180 / math.pi)
SHARE = Field[float]("direct feedback", float, ".4g")
EXACT = 1e-9  # relative to the distance from 1: of a factor at which the loop becomes unstable


@dataclass(frozen=True)
class LawMargins:
    """Stability of a law by itself, and small margins of its ideal loop.

    Attributes:
        growth: rate of the fastest growing state of the law by itself [1/s]; 0 if no state grows.
        direct_feedback: spectral radius of H, with the actuators' lag; 0 if no measurement contains the force at once.
        winds_up: description of where the forces are clipped if the law winds up there; empty otherwise.
        gain: factor above 1 and up to `LEAST_GAIN` at which the loop is unstable, or infinity.
        gain_lower: factor below 1, down to the inverse, at which the loop is unstable, or 0.
        disk: symmetric disk from 0 to 2; None if the ideal loop is unstable, no measurement makes a force, or the law is a
            passive element with inertance.
    """

    growth: float
    winds_up: str
    gain: float
    gain_lower: float
    disk: float | None
    direct_feedback: float = 0.0

    @property
    def own_force(self) -> str:
        """The direct feedback of a law that cannot be sampled, in words; empty for other laws."""
        if self.direct_feedback < 1:
            return ""
        times = SHARE.digits(self.direct_feedback)
        return f"the measurements contain {times} times the law's own force at once, which grows from sample to sample"

    @property
    def instability(self) -> str:
        """The instability of the law by itself, and its windup, in words; empty for a stable law."""
        if not self.growth:
            return ""
        return f"unstable by itself (+{rough(self.growth)} 1/s)" + (f", winds up {self.winds_up}" if self.winds_up else "")

    @property
    def nearest(self) -> float | None:
        """The small gain margin that is nearest to 1, either way; None without one."""
        nearest = self.gain if self.gain * self.gain_lower <= 1 else self.gain_lower
        return nearest if 0 < nearest < math.inf else None

    @property
    def pair(self) -> str:
        """Gain and disk margin as a pair, "-" for a gain margin that is not small."""
        return f"{'-' if self.nearest is None else _factor(self.nearest)}/{_disk(self.disk or 0.0)}"

    @property
    def small(self) -> str:
        """The margins that are small, in words; empty without any."""
        texts = [f"gain margin {_factor(self.nearest)}"] if self.nearest is not None else []
        texts += [f"disk margin {_disk(self.disk)}"] if self.disk is not None and self.disk < LEAST_DISK else []
        return ", ".join(texts)

    @property
    def record(self) -> dict[str, Any]:
        """The margins as JSON holds them; None for a gain margin that is not small, and for margins that do not exist."""
        return {
            "winds_up": bool(self.winds_up),
            "gain_margin": self.gain if math.isfinite(self.gain) else None,
            "gain_margin_lower": self.gain_lower or None,
            "disk_margin": self.disk,
            "direct_feedback": self.direct_feedback or None,
        }


def law_margins(vehicle: Vehicle, controller: AnyController) -> LawMargins:
    """Returns the stability of a law by itself, whether it winds up, and the small margins of its ideal loop.

    Nothing is small of a law that is not linear, to which no margin applies.
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
        if _growth(loop, np.ones(1))[0] < 0:  # rounding may decide on a marginal loop
            gain = _first_unstable(loop, FACTORS, math.inf)
            gain_lower = _first_unstable(loop, 1 / FACTORS, 0.0)
            disk = None if direct and _is_element(vehicle, controller) else disk_margin(loop).size
    return LawMargins(law.growth, where, gain, gain_lower, disk, direct)


def law_fault(vehicle: Vehicle, controller: AnyController) -> str:
    """Returns why a controller is never called the best, in words; empty for a sound one, and for a law that is not linear."""
    if controller.growth:
        return "unstable by itself"
    margin = law_margins(vehicle, controller).disk
    return f"disk margin below {LEAST_DISK:g}" if margin is not None and margin < LEAST_DISK else ""


def warnings(margins: Mapping[str, LawMargins]) -> list[str]:
    """Returns a sentence on the laws that are unstable by themselves, and another on small margins of the other laws."""
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
        f"WARNING: measurements contain the law's own force at once: {', '.join(times)}. Sampled or late, the force "
        "grows from sample to sample; lower the gain on accelerations, or filter them."
    )
    return [text] if times else []


def _clipped_forces(vehicle: Vehicle) -> str:
    """Returns where the forces are clipped, in words; empty if they are not."""
    if (force := vehicle.limits.actuator_force) is not None:
        return f"at {force / 1e3:g} kN" if force >= 1e3 else f"at {force:g} N"
    if (rate := vehicle.limits.force_rate) is not None:
        return f"at {rate / 1e3:g} kN/s"
    return "at the limits of the semi-active dampers" if vehicle.dampers else ""


def _is_element(vehicle: Vehicle, controller: Controller) -> bool:
    """Returns True if a law is a passive spring, damper and inerter between the ends of suspensions: none destabilises a car.

    The law then is u = -(K d + C d' + M d'') with symmetric K and M, and none of the three takes energy from nowhere.
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
    """Returns the growth of the loops with these factors on all forces [1/s]; infinite from one on that no force solves."""
    growth, direct = np.linalg.eigvals(loop.loop_matrix(factors)).real.max(axis=-1), np.linalg.eigvals(loop.D)
    limit = direct.real[np.abs(direct.imag) <= EXACT * np.abs(direct)].max(initial=0.0)
    return np.where(limit * factors >= 1, np.inf, growth)


def _first_unstable(loop: StateSpace, factors: Array, without: float) -> float:
    """Returns the factor nearest to 1 at which the loop becomes unstable, or `without` if none of these is unstable."""
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
    """Returns a factor with two digits of its distance from 1, at most six behind the point, and in dB."""
    distance = abs(factor - 1)
    digits = f"{factor:.{min(6, max(2, 1 - math.floor(math.log10(distance))))}f}" if distance else "1"
    return f"{digits} ({decibels(factor)})"


def decibels(factor: float) -> str:
    """Returns a factor above 0 in dB, with the unit."""
    return GAIN.text(20 * math.log10(factor))


def _disk(size: float) -> str:
    """Returns a disk margin, and the largest turn of all forces in degrees."""
    return f"{size:#.2g} ({TURN.digits(DiskMargin(size, math.nan).phase)})"
