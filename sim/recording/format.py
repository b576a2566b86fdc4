"""What a log must and may hold, beside its channels: the number of its format, and the keys of every command's result.

Together with what writes a log (`records` and `channels` of `mcap_writer.py`, and `provenance.py`) this is the format.
`sim.inspect` writes a log anew by the same functions, and holds it to that: what is missing, extra or another shows by
construction.
"""

from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError

FORMAT = 1
# The responses of a run: its topics in an MCAP file, and names of entities in a Rerun file. The exact sampled response has been
# called `linear` there, and in result.json, since there are logs; to people it is "sampled", as it is wherever no file is kept.
MUJOCO, SAMPLED, CONTINUOUS = "mujoco", "linear", "continuous"
LOADS, DAMPERS = "loads", "dampers"  # what acted beside: topics that older logs of this format have not
SINCE = ("half_step",)  # claims of a run that came with the first format that has a number: no older log has them
RESULTS: Mapping[str, tuple[str, ...]] = {  # of the commands that record, the keys of result.json
    "bump": ("runs", "road", "timestep"),
    "drive": ("runs", "road", "timestep", "measured_from", "definitions", "iri"),
    "sweep": ("sweeps", "amplitude", "timestep", "speed"),
    "margins": ("controller", "gain", "phase", "delay", "sample_period", "loops", "robustness", "loop", "fragility"),
    "envelope": (
        "controller",
        "axes",
        "threshold",
        "loads",
        "agreement",
        "unexplained",
        "done",
        "complete",
        "cells",
        "csv",
        "picture",
    ),
}
LATER = ("fragility", "iri", "loads")  # of these, what came when there were logs of this format: an older one lacks it
WHOLE = ("bump", "drive")  # whose log holds every run that the result is of, so that all of it is computed again


def check_keys(command: str, result: Mapping[str, Any]) -> None:
    """Whether a result is one of its command.

    Raises:
        InputError: a key is missing or unknown, or there is no such command.
    """
    if command not in RESULTS:
        raise InputError("it is of no command that records")
    absent = [key for key in RESULTS[command] if key not in result and key not in LATER]
    extra = [key for key in result if key not in RESULTS[command]]
    if absent or extra:
        what = f"lacks {absent[0]}" if absent else f"has {extra[0][:40]!r}, which is none of it"
        raise InputError(f"the result of sim.{command} {what}")
