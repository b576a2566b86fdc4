"""Findings about a log: claims that hold or fail, and differences of numbers from recomputed ones."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from sim.response.response import Response
from sim.runs.agreement import ROUNDING

HOLDS, FAILS, MISSING, NOTE = "holds", "FAILS", "missing", "note"
SAME = 1e-6  # relative: how far other versions of numpy, on another machine, may move a number that was derived
SINCE = ("until", "steps", "geometry", "allowed", "stops", "margins", "code_difference")  # keys that older logs may lack
HUGE = 1e150  # a linear response beyond it is unstable, and its squares overflow


@dataclass(frozen=True)
class Finding:
    """Result of the check of one claim.

    Attributes:
        part: subject of the claim.
        verdict: verdict, one of `HOLDS`, `FAILS`, `MISSING` (its proof is absent), `NOTE` (there was nothing to prove).
        text: the result in words.
    """

    part: str
    verdict: str
    text: str


def largest_difference(logged: Response, again: Response) -> tuple[float, str]:
    """Returns the largest difference between logged and recomputed response, over the peak of each signal, and that signal's
    name.
    """
    huge = ~np.all(np.abs(again.values) < HUGE, axis=1)
    end = float(again.time[huge.argmax()]) if huge.any() else math.inf
    logged, again = logged.until(end), again.until(end)
    far = {name: exceeds(logged[name], again[name], again.scale(name)) if len(again.time) else 0.0 for name in logged.names}
    worst = max(far, key=lambda name: far[name])
    return far[worst], worst


def exceeds(logged: Array, again: Array, scale: float | None = None) -> float:
    """Returns the largest difference, over a scale, by default the peak; infinite if a logged number is not finite."""
    if not np.all(np.isfinite(logged)):
        return math.inf
    size = scale if scale is not None else float(np.abs(again).max(initial=0.0))
    return float(np.abs(logged - again).max(initial=0.0)) / (size or 1.0)


def equal(said: Any, now: Any, relative: float, absolute: float) -> bool:
    """Returns True if two JSON values are equal, numbers to a tolerance."""
    if isinstance(now, list):
        if not isinstance(said, list) or len(said) != len(now):
            return False
        return all(equal(a, b, relative, absolute) for a, b in zip(said, now, strict=True))
    if isinstance(now, (int, float)) and not isinstance(now, bool):
        number = isinstance(said, (int, float)) and not isinstance(said, bool)
        return number and abs(said - now) <= max(relative * abs(now), absolute)
    return said == now


def different(said: Any, now: Any, path: str = "", absolute: float = ROUNDING) -> Iterator[str]:
    """Yields the paths at which a JSON value differs from the recomputed one.

    Args:
        path: path of the value in the record.
        absolute: tolerance of numbers, if that is more than the relative one, `SAME`.
    """
    if not isinstance(now, Mapping):
        if not equal(said, now, SAME, absolute):
            yield path
        return
    if not isinstance(said, Mapping):
        yield path
        return
    for key, value in now.items():
        here = f"{path}.{key}" if path else key
        # Of two runs that may each be `SAME` of a peak off, the difference may be, too.
        near = SAME if key in ("half_step", "code_difference") else absolute
        if key in said:
            yield from different(said[key], value, here, near)
        elif key not in SINCE:
            yield f"{here} is missing"
    for key in said:
        if key not in now:
            yield f"{path + '.' if path else ''}{key} is unknown"


def merge_repeats(names: Sequence[str], what: str) -> str:
    """The first of many that are wrong for one cause, and how many more there are, of what kind."""
    more = f" (and {len(names) - 1} more {what}, the first of them {names[1]})" if len(names) > 1 else ""
    return names[0] + more


def count(value: Any) -> int:
    """Returns the number of numbers in a JSON value."""
    if isinstance(value, Mapping):
        return sum(count(item) for item in value.values())
    if isinstance(value, list):
        return sum(count(item) for item in value)
    return int(isinstance(value, (int, float)) and not isinstance(value, bool))
