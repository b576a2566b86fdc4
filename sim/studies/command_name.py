"""Name of the command that runs a study."""

from importlib.util import find_spec


def command_of(name: str) -> str:
    """Returns the text that follows `python -m` for a study: `sim.NAME` if this module exists, otherwise `sim NAME`.

    Args:
        name: name of the study in `STUDIES`.
    """
    return f"sim.{name}" if find_spec(f"sim.{name}") else f"sim {name}"
