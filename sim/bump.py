"""`python -m sim.bump`: controllers over a bump, in MuJoCo and in linear analysis, compared and logged."""

from collections.abc import Sequence

from models.common.command import run_command
from sim.command.bump_options import checked_road, parser, words


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or logs folder.
    """
    options = parser().parse_args(arguments)
    from sim.command.driving import drive

    return drive(options, checked_road, words)


if __name__ == "__main__":
    run_command(main)
