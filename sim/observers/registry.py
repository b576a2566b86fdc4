"""The observers that a run can do without, by name: what is not registered is unknown of every run."""

from typing import Any

from models.common.extensions import OBSERVERS


def observer(name: str) -> Any:
    """Returns the observer of a name, or None."""
    return OBSERVERS.load(name) if name in OBSERVERS else None
