"""`python -m sim.bump`: controllers over a bump, in MuJoCo and in linear analysis, compared and logged."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.bump")

from collections.abc import Sequence

from sim.command.bump_options import checked_road, parser, words


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or logs folder.
    """
    options = parser().parse_args(arguments)
    from sim.command.driving import drive

    return drive(options, checked_road, words)
