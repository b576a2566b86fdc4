"""Bump stops that a suspension reaches in a run: compression, force and time of the deepest contact."""

from dataclasses import dataclass

import numpy as np

from models.characteristics import SIDES
from models.document.field import Field, Record
from models.parts.part import Part
from sim.drive.regime import AT, BUMP_STOP
from sim.observers.results import WHEN
from sim.runs.result import RunResult


@dataclass(frozen=True)
class Touch:
    """Deepest contact of a suspension with one of its stops.

    Attributes:
        side: end of the suspension's stroke at which the stop is, one of `SIDES`.
        squeeze: compression of the stop, which is the travel beyond the free stroke [m].
        force: force of the stop at this compression [N].
        time: time of the deepest contact [s].
    """

    side: str
    squeeze: float
    force: float
    time: float


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 99.95 else f"{value:.3g}"


SQUEEZE = Field[Touch]("compression", lambda one: one.squeeze, _digits, 1e3, "squeeze", "mm")
FORCE = Field[Touch]("force", lambda one: one.force, _digits, key="force", unit="N")
TIME = Field[Touch]("time", lambda one: one.time, WHEN.form, key="time", unit="s")


def touches(run: RunResult) -> dict[str, dict[str, Touch | None]]:
    """Returns the deepest simulated contact with each stop, by name of the deflection and by side; None for a stop without
    contact.

    Contacts after a run has become invalid are ignored.
    """
    physics = run.physics.until(run.broke_off[1]) if run.broke_off is not None else run.physics
    contacts: dict[str, dict[str, Touch | None]] = {}
    for name, strokes in run.vehicle.parts.strokes.items():
        contacts[name] = {}
        stops = [one.part for one in run.vehicle.parts if one.deflection == name and _is_stop(one.part)]
        for side, stroke in strokes.items():
            sign = -1.0 if side == SIDES[0] else 1.0
            travel = sign * physics[name]
            k = int(travel.argmax()) if len(travel) else 0
            if not len(travel) or travel[k] < AT * stroke:
                contacts[name][side] = None
                continue
            squeeze, still = max(0.0, float(travel[k]) - stroke), np.zeros(())
            force = abs(sum(float(one.pull(np.array(sign * (stroke + squeeze)), still)) for one in stops))
            contacts[name][side] = Touch(side, squeeze, force, float(physics.time[k]))
    return contacts


def _is_stop(part: Part) -> bool:
    return any(limit.end == BUMP_STOP.name for limit in part.limits())


# Largest compression [m] and force [N] of each stop in a run, with the time [s]; None if the stop is not reached
STOPS = Record(SQUEEZE, FORCE, TIME).all(touches)


def stop_note(run: RunResult) -> str:
    """Returns a sentence on the hardest contact with the stops on each side in a run; empty if there was no contact."""
    corners, reached, words = {part.deflection: part.corner for part in run.vehicle.kind.suspensions}, touches(run), []
    for side in SIDES:
        contacts = [(touch, corners[name]) for name, sides in reached.items() if (touch := sides.get(side)) is not None]
        if contacts:
            one, corner = max(contacts, key=lambda contact: (contact[0].force, contact[0].squeeze))
            where = f"{SQUEEZE.text(one.squeeze)}, {FORCE.text(one.force)} at {TIME.text(one.time)}"
            words.append(f"{side} {corner}".rstrip() + f" {where}")
    return f"stops: {'; '.join(words)}" if words else ""


def stop_names(run: RunResult, when: float) -> str:
    """Returns the names of the stops that suspensions reach at a time [s]: bump stop, rebound stop, or both."""
    k = int(np.searchsorted(run.physics.time, when))
    at = [
        limit.sign for limit in BUMP_STOP.thresholds(run.vehicle) if limit.towards(limit.of(run.physics))[k] >= AT * limit.value
    ]
    return " and ".join(f"{side} stop" for side, sign in zip(SIDES, (-1.0, 1.0), strict=True) if sign in at) or BUMP_STOP.name
