"""Findings about a log: statements in the log that hold or fail, and differences between logged and recomputed numbers."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.drive.response import Response
from sim.runs.agreement import ROUNDING

HOLDS, FAILS, MISSING, NOTE = "holds", "FAILS", "missing", "note"
# allowed relative difference of a derived number that is recomputed on another machine or with another version of NumPy
SAME = 1e-6
# JSON keys that older logs may lack. Only vehicles with nonlinear springs or dampers have the last two keys.
SINCE = {"until", "steps", "commands", "cause", "allowed", "stops", "margins", "code_difference", "linearisation", "reference"}
# JSON keys that are not recomputed: only older logs contain them, or only logs of laws that a replay does not run
OLDER_KEYS = {"geometry", "otherwise", "played", "commands"}
# JSON keys of differences between two runs, relative to a peak; such a difference may change by `SAME` (absolute)
DIFFERENCES = {"half_step", "code_difference"}
LESS = {"residual", "allowed"}  # JSON keys in an energy balance whose rounding errors were larger in older versions
HUGE = 1e150  # a loop whose linear response exceeds this value is unstable; the square of a larger response may overflow


@dataclass(frozen=True)
class Finding:
    """Result of the check of one claim in a log.

    Attributes:
        part: part of the log that contains the claim, such as "certificate".
        verdict: `HOLDS`, `FAILS`, `MISSING` (the log does not contain the proof), or `NOTE` (there is nothing to prove).
        text: printed sentence that states the result of the check.
    """

    part: str
    verdict: str
    text: str

    @property
    def proved(self) -> bool:
        """True if the claim holds or there is nothing to prove."""
        return self.verdict in (HOLDS, NOTE)


def largest_difference(logged: Response, again: Response) -> tuple[float, str]:
    """Returns the largest difference between a logged and a recomputed response, and the name of the signal with this
    difference.

    Each difference is relative to the peak of its signal; it is infinite if a logged number is not finite. Samples are not
    compared after the time at which the recomputed response exceeds `HUGE`.
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
    """Yields the numbers, texts and empty containers of a JSON value, each with its path, such as `runs.0.energy`."""
    if not isinstance(value, (Mapping, list)) or not value:
        yield path, value
        return
    for key, part in value.items() if isinstance(value, Mapping) else enumerate(value):
        yield from leaves(part, f"{path}.{key}".removeprefix("."))


def different(said: Any, now: Any) -> Iterator[str]:
    """Compares a JSON value with its recomputed value; yields the paths at which the two differ.

    Numbers count as equal up to a relative difference of `SAME`.
    """
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
    """Returns True if a JSON value is a number. The values True and False do not count as numbers."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
