"""What a command's options ask for, in plain data: a log's command line is held against it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from models.reality import Implementation

Road = Mapping[str, Any]  # as it describes itself


@dataclass(frozen=True)
class Asked:
    """What a command is asked for.

    Attributes:
        controllers: of the logged runs, in their order; a single one may have several runs.
        samples: of every run; None where the command itself finds out how many it takes.
        timestep: [s].
        road: whether a run may have had the road that describes itself so.
        run: whether a run may be called so, and have this implementation.
        result: what of the result follows from the options, by key.
    """

    controllers: Sequence[str]
    samples: int | None
    timestep: float
    road: Callable[[Road], bool]
    run: Callable[[str, Implementation], bool]
    result: Mapping[str, Any] = field(default_factory=dict)


def same_path(first: str, second: str) -> bool:
    """Whether two texts name one path, on whatever system they were written."""
    return PurePosixPath(first.replace("\\", "/")) == PurePosixPath(second.replace("\\", "/"))
