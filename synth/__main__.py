"""The command `python -m synth`: prints the design table of a vehicle file, and certifies each of its controllers."""

if __name__ == "__main__":
    from models.common.cli import run

    run("synth.__main__")

from argparse import Namespace
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from models.common.command import ALL, chosen_controllers, print_remarks
from models.common.errors import InputError, list_names
from synth.command.options import parse_options

if TYPE_CHECKING:
    from models.vehicle.vehicle import Vehicle


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit code.

    Raises:
        InputError: the options or the vehicle file contain an error.
    """
    options = parse_options(arguments)
    from models.vehicle.vehicle import read_vehicle

    if options.check is not None and options.check.is_dir():
        from synth.command.export import check_folder

        return check_folder(options.check, options)
    vehicle = print_remarks(read_vehicle(options.check or options.vehicle))
    if options.export is not None:
        from synth.command.export import export

        return export(vehicle, options)
    if options.front is not None:
        from synth.command.trade_off import answer as front

        return front(vehicle, options)
    names = [] if options.check else _names(vehicle, options)
    # some controllers drive dampers and others drive active actuators, so the file's actuators are used unchanged
    with suppress(InputError):
        vehicle = vehicle.with_common_actuators(names)
    if options.rates:
        from synth.command.sample_rate import answer as rates

        return rates(vehicle, names if options.controller else [name for name in names if name != "passive"], options)
    from synth.command.design_table import answer

    return answer(vehicle, names, options)


def _names(vehicle: "Vehicle", options: Namespace) -> list[str]:
    """Returns the names of the selected controllers, without duplicates."""
    from models.laws.combinations import check_command, goes

    linear = [vehicle.controllers[name] for name in vehicle.linear_names if name in vehicle.controllers]
    designed = [entry.name for entry in linear if goes("zero_l", entry.parts)]
    everything = designed if options.zero_l else vehicle.linear_names
    if options.zero_l and not designed:
        raise InputError(
            f"--zero-l applies only to two-step designs, but {vehicle.source} contains no such design; omit --zero-l"
        )
    names = (
        everything
        if options.controller == [ALL]
        else chosen_controllers(vehicle.controller_names, options.controller, everything)
    )
    for name in names:
        if options.zero_l and name in vehicle.controllers:
            check_command(f"controller {name!r}", vehicle.controllers[name].parts, "zero_l")
        elif options.zero_l:
            raise InputError(
                f"--zero-l applies only to two-step designs, but {name!r} is not one; give one of {list_names(designed)}"
            )
    if options.refine and list(names) == ["passive"]:
        raise InputError("--refine: the passive vehicle has no gain to refine; give a controller, or omit --refine")
    return list(names)
