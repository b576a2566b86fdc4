"""Bump stops that a run reaches: compression, force and time of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.printed import finite, wrapped
from models.suspension.bump_stops import SIDES
from sim.response.regime import AT, BUMP_STOP
from sim.runs.run import Run


@dataclass(frozen=True)
class Touch:
    """Deepest contact of a suspension with one of its stops.

    Attributes:
        side: side of the stop, one of `SIDES`.
        squeeze: travel beyond the stroke [m].
        force: force of the stop [N].
        time: time of that sample [s].
    """

    side: str
    squeeze: float
    force: float
    time: float

    @property
    def words(self) -> str:
        """Squeeze, force and time."""
        return f"{_digits(1e3 * self.squeeze)} mm, {_digits(self.force)} N at {self.time:.4g} s"


def touches(run: Run) -> dict[str, dict[str, Touch | None]]:
    """Returns MuJoCo's deepest contact with every stop, by deflection and side, until a run broke off; None without one."""
    physics = run.physics.until(run.broke_off[1]) if run.broke_off is not None else run.physics
    contacts: dict[str, dict[str, Touch | None]] = {}
    for name, stops in run.vehicle.limits.stops(run.vehicle.kind.suspensions).items():
        contacts[name] = {}
        for side, (sign, stop) in stops.sides.items():
            travel = sign * physics[name]
            k = int(travel.argmax()) if len(travel) else 0
            if not len(travel) or travel[k] < AT * stop.stroke:
                contacts[name][side] = None
                continue
            squeeze = max(0.0, float(travel[k]) - stop.stroke)
            contacts[name][side] = Touch(side, squeeze, float(stop.acts(np.array(squeeze))), float(physics.time[k]))
    return contacts


def stops_object(run: Run) -> dict[str, dict[str, dict[str, float | None] | None]]:
    """Returns the contacts as a JSON object: squeeze [m], force [N] and time [s] of every stop, or None if it is not reached."""
    return {
        name: {
            side: touch and {"squeeze": finite(touch.squeeze), "force": finite(touch.force), "time": finite(touch.time)}
            for side, touch in sides.items()
        }
        for name, sides in touches(run).items()
    }


def run_stop_lines(run: Run, what: str = "stops") -> list[str]:
    """Returns a line on each suspension of a run that reaches a stop, which begins with what it is about."""
    corners = {part.deflection: part.corner for part in run.vehicle.kind.suspensions}
    reached = {name: [touch for touch in sides.values() if touch is not None] for name, sides in touches(run).items()}
    return [
        f"{what}{f', {corners[name]}' if corners[name] else ''}: {'; '.join(f'{one.side} {one.words}' for one in some)}"
        for name, some in reached.items()
        if some
    ]


def stop_lines(runs: Sequence[Run], few: int, what: str = "stops") -> list[str]:
    """Returns lines on the stops that runs reach: of one run each suspension's, of a few the hardest contact of each side.

    Args:
        few: number of runs up to which each has a line; of more there is one line, on the hardest contact of all.
        what: beginning of each line.
    """
    if len(runs) == 1:
        return [line for words in run_stop_lines(runs[0], what) for line in wrapped(words, "  ", 4)]
    contacts = [(run, touches(run)) for run in runs]
    hardest = [(run.controller.name, side, one) for run, each in contacts for side in SIDES if (one := _hardest(run, each, side))]
    if len(runs) > few and hardest:
        name, side, (corner, touch) = max(hardest, key=lambda each: (each[2][1].force, each[2][1].squeeze))
        some = len({name for name, *_ in hardest})
        words = f"{what}, reached by {some} of {len(runs)}, hardest by {name}: {side}{corner} {touch.words}"
        return wrapped(words, "  ", 4)
    lines: list[str] = []
    for run in runs:
        said = [f"{side}{one[0]} {one[1].words}" for name, side, one in hardest if name == run.controller.name]
        lines += wrapped(f"{what}, {run.controller.name}: {'; '.join(said)}", "  ", 4) if said else []
    return lines


def _hardest(run: Run, reached: Mapping[str, Mapping[str, Touch | None]], side: str) -> tuple[str, Touch] | None:
    """Returns the hardest contact of a run with the stops of one side, after its corner in words, or None without a contact."""
    corners = {part.deflection: f" {part.corner}" if part.corner else "" for part in run.vehicle.kind.suspensions}
    contacts = [(corners[name], touch) for name, sides in reached.items() if (touch := sides.get(side)) is not None]
    return max(contacts, key=lambda one: (one[1].force, one[1].squeeze), default=None)


def stop_names(run: Run, when: float) -> str:
    """Returns the names of the stops at which suspensions are at a time [s]: bump stop, rebound stop, or both."""
    k = int(np.searchsorted(run.physics.time, when))
    at = [
        limit.sign for limit in BUMP_STOP.thresholds(run.vehicle) if limit.towards(limit.of(run.physics))[k] >= AT * limit.value
    ]
    return " and ".join(f"{side} stop" for side, sign in zip(SIDES, (-1.0, 1.0), strict=True) if sign in at) or BUMP_STOP.name


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 99.95 else f"{value:.3g}"
