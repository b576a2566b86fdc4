"""Commands of studies, by their names in `EXTENSIONS`."""

from importlib.util import find_spec


def command_of(name: str) -> str:
    """Returns the command of a study, as after `python -m`: a module of its own, such as sim.margins, or `sim NAME`."""
    return f"sim.{name}" if find_spec(f"sim.{name}") else f"sim {name}"
