"""Findings about a log: claims that hold or fail, and differences of numbers from recomputed ones."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.drive.response import Response
from sim.runs.agreement import ROUNDING

HOLDS, FAILS, MISSING, NOTE = "holds", "FAILS", "missing", "note"
SAME = 1e-6  # relative: how far other versions of numpy, on another machine, may move a number that was derived
# Older logs may lack these; the last two are of vehicles with characteristics.
SINCE = {"until", "steps", "commands", "cause", "allowed", "stops", "margins", "code_difference", "linearisation", "reference"}
OLDER_KEYS = {"geometry", "otherwise", "played", "commands"}  # keys of older logs alone, or of a law that a replay does not run
DIFFERENCES = {"half_step", "code_difference"}  # of two runs that may each be `SAME` of a peak off, and so may they
LESS = {"residual", "allowed"}  # of an energy balance, which older versions computed with more rounding
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

    @property
    def proved(self) -> bool:
        """Returns True if there is nothing wrong."""
        return self.verdict in (HOLDS, NOTE)


def largest_difference(logged: Response, again: Response) -> tuple[float, str]:
    """Returns the largest difference between logged and recomputed response, over the peak of each signal, and that signal's
    name; infinite if a logged number is not finite.
    """
    huge = ~np.all(np.abs(again.values) < HUGE, axis=1)
    end = float(again.time[huge.argmax()]) if huge.any() else math.inf
    logged, again = logged.until(end), again.until(end)
    if not len(again.time):
        return 0.0, ""
    shares = {name: float(np.abs(logged[name] - again[name]).max()) / (again.scale(name) or 1.0) for name in logged.names}
    far = {name: share if math.isfinite(share) else math.inf for name, share in shares.items()}
    worst = max(far, key=far.__getitem__)
    return far[worst], worst


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yields every number, text and empty container of a JSON value, with its path."""
    if not isinstance(value, (Mapping, list)) or not value:
        yield path, value
        return
    for key, part in value.items() if isinstance(value, Mapping) else enumerate(value):
        yield from leaves(part, f"{path}.{key}".removeprefix("."))


def different(said: Any, now: Any) -> Iterator[str]:
    """Yields the paths at which a JSON value differs from the recomputed one, numbers by more than `SAME`, relative."""
    there, here = dict(leaves(said)), dict(leaves(now))
    for path, value in here.items():
        keys = {*path.split(".")}
        if path not in there:
            yield from () if keys & SINCE else (f"{path} is missing",)
        elif keys & LESS and is_number(value) and is_number(there[path]) and value <= there[path]:
            continue
        elif not _equal(there[path], value, SAME if keys & DIFFERENCES else ROUNDING):
            yield path
    yield from (f"{path} is unknown" for path in there if path not in here and not {*path.split(".")} & OLDER_KEYS)


def _equal(said: Any, now: Any, absolute: float) -> bool:
    if is_number(said) and is_number(now):
        return abs(said - now) <= max(SAME * abs(now), absolute)
    return type(said) is type(now) and said == now


def is_number(value: Any) -> bool:
    """Returns True for a number of JSON."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
