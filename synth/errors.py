"""What can go wrong in a design. A failure is raised, never returned as an empty result."""

from models.errors import InputError


class DesignError(InputError):
    """No controller could be designed. The message says what happened, what usually causes it, what to do."""


class InfeasibleError(DesignError):
    """The LMI problem has no solution with eta > 0."""
