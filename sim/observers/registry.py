"""The observers that a run can do without, by name: what is not registered is unknown of every run."""

from typing import Any

from models.common.lazy import named

OBSERVERS = {  # name -> module, and its class for batches, see `sim.drive.drive.Observer`, or its function of a recording
    "energy": "sim.observers.energy:energy",
    "steps": "sim.observers.steps:compare_steps",
    "commands": "sim.observers.commands:compare_commands",
    "twin": "sim.observers.twin:Twin",
    "growth": "sim.observers.growth:Growth",
}


def observer(name: str) -> Any:
    """Returns the observer of a name, or None."""
    return named(OBSERVERS[name]) if name in OBSERVERS else None
