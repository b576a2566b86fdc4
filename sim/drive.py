"""`python -m sim.drive`: controllers over one road of any kind, in MuJoCo and in linear analysis, compared and measured."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.drive")

from collections.abc import Sequence

from sim.command.drive_options import parser, requested_road


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file, road or logs folder.
    """
    options = parser().parse_args(arguments)
    from sim.command.driving import drive

    return drive(options, requested_road, lambda road: road.words, rides=True)
