"""What can go wrong in a design. A failure is raised, never returned as an empty result."""

from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError


class DesignError(InputError):
    """No controller could be designed. The message says what happened, what usually causes it, what to do."""


class BatchError(DesignError):
    """Some of many could not be designed. It carries those that were.

    Attributes:
        designs: what was designed, by index.
        failures: why the others were not, by index.
    """

    def __init__(self, message: str, designs: Mapping[int, Any], failures: Mapping[int, InputError]) -> None:
        super().__init__(message)
        self.designs, self.failures = dict(designs), dict(failures)


class InfeasibleError(DesignError):
    """The LMI problem has no solution with eta > 0."""


class TooLargeError(DesignError):
    """The LMI problem has more unknowns than its central path is followed with."""
