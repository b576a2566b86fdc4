"""Functions that all commands use: option parsing, one-line error messages, and versions of packages."""

import argparse
import functools
import json
import math
import re
import shlex
import sys
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from models.common.errors import TRACEBACK, InputError, list_names, one_line
from models.common.printed import WIDTH, command, show, wrap_text

PACKAGES = ("roadproof", "mujoco", "numpy", "scipy", "mcap", "protobuf", "foxglove-schemas-protobuf", "rerun-sdk")


def versions() -> dict[str, str]:
    """Returns the versions of Python and of all packages that influence numerical results."""
    return dict(_versions())


@functools.cache  # the metadata are cached, because reading them takes 20 ms, and they do not change while a process runs
def _versions() -> dict[str, str]:
    import platform
    from importlib import metadata

    versions_by_name = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions_by_name[package] = metadata.version(package)
        except metadata.PackageNotFoundError:  # the program runs from a source checkout, without an installed package
            versions_by_name[package] = "not installed"
    return versions_by_name


ALL = "all"  # a user writes this word instead of a controller's name to select all controllers


class Parser(argparse.ArgumentParser):
    """Command-line parser with one-line error messages.

    The parser refuses options with an empty value, and repeated options unless they are declared as repeatable.
    """

    # True if the program was called as `roadproof VERB`; help and error messages then show the command in this form
    by_verb = False

    def __init__(self, prog: str, description: str, epilog: str, page: str = "") -> None:
        self.module = prog
        self.page = page or f"docs/how-to/{prog.rpartition('.')[2]}.md"
        super().__init__(
            prog=self._called(f"python -m {prog}"),
            description=_page(description),
            epilog=_page(f"{epilog.rstrip()}\n\nexplanation of the printed output: {self.page}"),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        # With this pattern, argparse reads -1e-3 and -inf as numbers, not as options. Before Python 3.14, argparse does not
        # accept exponents.
        self._negative_number_matcher = re.compile(r"-(\.?\d|(inf|infinity|nan)$)", re.IGNORECASE)
        self.register("type", None, _text)
        self.register("type", Path, _path)
        self.register("action", None, _Once)
        self.register("action", "store", _Once)
        self.register("action", "store_true", _Flag)
        self.add_argument(TRACEBACK, action="store_true", help="show the Python traceback of an error, for a bug report")

    def _called(self, text: str) -> str:
        """Returns a text in which every command is written in the form in which the user called the present command:

        `roadproof bump` or `python -m sim.bump`.
        """
        return re.sub(r"python -m (sim$|sim[. ])?", "roadproof ", text).rstrip(" ") if self.by_verb else text

    def parse_known_args(self, args=None, namespace=None):  # pyright: ignore[reportIncompatibleMethodOverride] - its overloads
        """Parses the arguments and returns the known options and the unknown arguments.

        Refuses a value that does not belong to an option, for example the second word of a name that has spaces but no quotes.
        """
        options, others = super().parse_known_args(args, namespace)
        if args and others and not others[0].startswith("-"):
            self.error(f"unrecognized argument {others[0]!r}; {self._advice(args[: args.index(others[0]) + 1])}")
        return options, others

    def _advice(self, args: Sequence[str]) -> str:
        """Returns advice for the error message about the last unexpected argument."""
        first = max((i for i, one in enumerate(args) if one.startswith("-")), default=-1)
        option, _, value = args[first].partition("=") if first >= 0 else ("", "", "")
        values, action = [*filter(None, [value]), *args[first + 1 :]], self._option_string_actions.get(option)
        # The option is unknown or takes no value, so the values that follow are arguments of the command itself
        if action is None or action.nargs == 0:
            option, action = "", next(iter(self._get_positional_actions()), None)
        if action is None or len(values) < 2:
            usual = "--vehicle" if values[-1].endswith(".toml") else "" if "." in values[-1] else "--controller"
            example = f", as in {usual} {shlex.quote(values[-1])}" if usual in self._option_string_actions else ""
            return f"give every value after its option{example}"
        together = f"{option} {shlex.quote(' '.join(values))}".lstrip()
        quoted = f"put quotes around a value that contains spaces, as in {together}"
        if isinstance(action, argparse._AppendAction | _Vehicles):
            each = " ".join(f"{option} {shlex.quote(one)}" for one in values)
            return f"repeat {option} for several values, as in {each}, or {quoted}"
        return quoted

    def parse_args(self, args=None, namespace=None):  # pyright: ignore[reportIncompatibleMethodOverride] - its overloads
        """Returns the options, including the names of the options that the user gave (`given`) and the command line
        (`command_line`).
        """
        args = sys.argv[1:] if args is None else args
        for argument in args:
            if re.fullmatch(r"--[\w-]+=--", argument):  # argparse would take "--" as the end of the options
                self.error(f"argument {argument[:-3]}: '--' is not a value; give a value")
        _remarks.clear()
        start = namespace or argparse.Namespace()
        start.given = set()
        start.command_line = shlex.join(["roadproof", re.split("[. ]", self.module)[-1], *args])
        return super().parse_args(args, start)

    def error(self, message: str) -> NoReturn:
        """Raises an InputError with a one-line message about invalid options; the exit code is 2."""
        raise InputError(f"{message}; see {self.prog} --help")

    def add_controller_and_vehicle(self, default: str, several: str = "") -> None:
        """Adds the options `--controller`, which may be repeated, and `--vehicle`.

        Args:
            default: description of the controllers that are used without `--controller`.
            several: purpose of giving `--vehicle` several times, for the help text. If this text is not empty, the values of
                `--vehicle` are in the attribute `vehicles`. The text is empty for commands with one vehicle.
        """
        self.add_argument(
            "--controller",
            action="append",
            type=_name,
            metavar="NAME",
            help="passive, state (state feedback), a controller of the vehicle file, or all; the option can be repeated "
            f"({default})",
        )
        if several:
            self.add_argument(
                "--vehicle",
                dest="vehicles",
                action=_Vehicles,
                default=("quarter_car",),
                metavar="FILE",
                help=f"vehicle file, or name of a built-in vehicle; repeat the option for {several} (default: quarter_car)",
            )
        else:
            self._add_vehicle()

    def add_one(self, which: str) -> None:
        """Adds the options `--controller`, not repeatable, and `--vehicle`."""
        usual = "default: the first linear controller of the vehicle file"
        self.add_argument("--controller", type=_name, metavar="NAME", help=f"{which} ({usual})")
        self._add_vehicle()

    def _add_vehicle(self) -> None:
        meaning = "vehicle file, or name of a built-in vehicle (default: quarter_car)"
        self.add_argument("--vehicle", default="quarter_car", metavar="FILE", help=meaning)

    def add_number(self, option: str, default: float | None, unit: str, meaning: str, unset: str = "") -> None:
        """Adds an option for a finite number, or a number with its unit, such as 90km/h.

        The argument `unset` describes the meaning of the default None.
        """
        usual = unset if default is None else f"{default:g}"
        said = f"{meaning} [{unit}] (default: {usual})"
        self.add_argument(option, type=_number_in(unit), default=default, metavar=unit, help=said)

    def add_numbers(self, option: str, unit: str, meaning: str) -> None:
        """Adds an option for one or more finite numbers, with or without units."""
        self.add_argument(option, type=_number_in(unit), nargs="+", metavar=unit, help=f"{meaning} [{unit}]")

    def add_count(
        self, option: str, meaning: str, default: str, low: int, high: int, unset: int | None = None, many: bool = False
    ) -> None:
        """Adds an option for an integer from `low` to `high`, or for several integers if `many` is True.

        The argument `unset` is the value for a command line without the option; `default` describes the value `unset` in the
        help text.
        """

        def count(text: str) -> int:
            try:
                value = int(text)
            except ValueError:
                raise argparse.ArgumentTypeError(f"{text!r} is not an integer; give an integer from {low} to {high}") from None
            if not low <= value <= high:
                raise argparse.ArgumentTypeError(f"{text} is not allowed; give an integer from {low} to {high}")
            return value

        nargs = "+" if many else None
        self.add_argument(option, type=count, nargs=nargs, default=unset, metavar="N", help=f"{meaning} (default: {default})")

    def add_printed(self, what: str, brief: str = "") -> None:
        """Adds the options `--verbose` and `--json`, and also `--brief` if its help text is not empty.

        A command line may contain only one of `--verbose`, `--json` and `--brief`.

        Args:
            what: description of the details that `--verbose` prints.
            brief: help text of `--brief`; empty for a command without this option.
        """
        printed = self.add_mutually_exclusive_group()
        printed.add_argument("-v", "--verbose", action="store_true", help=f"also print {what}")
        if brief:
            printed.add_argument("--brief", action="store_true", help=brief)
        printed.add_argument("--json", action="store_true", help="print one JSON object and nothing else")

    def add_exported(
        self, what: str = "run the controller as compiled code from this folder, which roadproof synth --export wrote"
    ) -> None:
        """Adds the option `--as`, which names the folder of exported code; `what` is the help text of the option."""
        self.add_argument("--as", dest="exported", type=Path, metavar="DIR", help=what)

    def add_loads(self, what: str, syntax: str) -> None:
        """Adds the option `--load`, which may be repeated, with the syntax of loads in its help text."""
        meaning = f"{what}; may be repeated, and then all loads act together: {syntax}"
        self.add_argument("--load", dest="loads", action="append", default=[], metavar="LOAD", help=meaning)

    def add_gone(self, option: str, instead: str) -> None:
        """Adds an option that was removed; the error message for this option gives advice."""
        self.add_argument(option, action=_GoneOption, help=argparse.SUPPRESS, instead=instead)

    def add_logs(self, what: str) -> None:
        """Adds the option `--logs`, for a command that records logs only if the user gives this option."""
        self.add_argument("--logs", type=Path, metavar="DIR", help=f"record {what} in this folder (default: no recording)")


def chosen_controllers(names: Sequence[str], given: Sequence[str] | None, usual: Sequence[str] = ()) -> list[str]:
    """Returns the controllers that `--controller` selects, in the order of the command line.

    Args:
        names: names of all controllers of the vehicle.
        given: values of `--controller`.
        usual: names of the controllers that are selected without `--controller`.

    Raises:
        InputError: no controller is named, a name is unknown or given twice, or `all` is given together with a name.
    """
    for name in given or ():
        if name not in (ALL, *names):
            several = re.split(r"[\s,]+", name)
            each = f"; repeat the option, as in --controller {' --controller '.join(several)}" * ({*several} <= {*names})
            raise InputError(f"unknown controller {name!r}; the controllers of this vehicle are {list_names(names)}{each}")
        if (given or []).count(name) > 1:
            raise InputError(f"--controller {name} is given twice; give it once")
    if not given and not usual:
        raise InputError(f"no controller is given; give --controller with one of: {ALL}, {', '.join(names)}")
    if given and ALL in given and len(given) > 1:
        raise InputError(
            f"--controller {ALL} already selects every controller; omit --controller {ALL}, or all other --controller options"
        )
    if given == [ALL]:
        return list(names)
    return list(given or usual)


def chosen_of(
    vehicles: Mapping[str, Sequence[str]], given: Sequence[str] | None, usual: Sequence[str] = ()
) -> dict[str, list[str]]:
    """Returns the controllers that `--controller` selects for several vehicles.

    For each vehicle, the result contains the selected controllers that this vehicle has.

    Args:
        vehicles: names of all controllers of each vehicle, by a key that identifies the vehicle.
        given: names of controllers on the command line, as in `chosen_controllers`.
        usual: names of the default controllers, as in `chosen_controllers`.

    Raises:
        InputError: `chosen_controllers` raises this error, or a vehicle has none of the selected controllers.
    """
    known = list(dict.fromkeys(name for names in vehicles.values() for name in names))
    every = chosen_controllers(known, given, usual)
    selected = {key: [name for name in every if name in names] for key, names in vehicles.items()}
    for key, names in vehicles.items():
        if not selected[key]:
            raise InputError(
                f"--vehicle {key}: this vehicle has none of the controllers {list_names(every)}; add --controller "
                f"with one of {list_names(names)}"
            )
    return selected


def one_chosen(names: Sequence[str], given: str | None, usual: str = "") -> str:
    """Returns the controller that a single `--controller` selects.

    Args:
        names: names of all controllers that the user may choose.
        given: value of `--controller`.
        usual: controller that is used if `--controller` is not given; empty if the option is required.

    Raises:
        InputError: no controller is named, or the name is unknown.
    """
    allowed = f"give --controller with one of: {', '.join(names)}"
    if given is None and usual:
        return usual
    if given is None:
        raise InputError(f"no controller is given; {allowed}")
    if given == ALL:
        raise InputError(f"--controller {ALL} is not allowed, because this command takes only one controller; {allowed}")
    if given not in names:
        raise InputError(f"unknown controller {given!r}; {allowed}")
    return given


class _Once(argparse.Action):
    """Option that may be given only once."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        if option_string and self.dest in namespace.given:
            raise argparse.ArgumentError(self, "is given twice; give it once")
        namespace.given.add(self.dest)
        setattr(namespace, self.dest, values)


class _Vehicles(argparse.Action):
    """Option that may be given several times. If the option is on the command line, its values replace the default."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        before = getattr(namespace, self.dest) if self.dest in namespace.given else ()
        namespace.given.add(self.dest)
        setattr(namespace, self.dest, (*before, values))


class _GoneOption(argparse.Action):
    """Removed option, whose use causes an error message with advice."""

    def __init__(self, option_strings, dest, instead, help=None) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs="?", help=help)
        self._instead = instead

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        parser.error(f"{option_string} is gone; {self._instead}")


class _Flag(argparse.Action):
    """Option without a value."""

    def __init__(self, option_strings, dest, help=None) -> None:
        super().__init__(option_strings, dest, nargs=0, default=False, help=help)

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        namespace.given.add(self.dest)
        setattr(namespace, self.dest, True)


def complain(message: str) -> None:
    """Prints a message to stderr as one printable line."""
    show("")  # an empty text removes the line that shows the progress
    print(f"roadproof: {one_line(message)}", file=sys.stderr)


_remarks = list[str]()  # warnings about vehicles and roads that the running command has collected


def print_remarks(given: Any) -> Any:
    """Returns a vehicle or road after printing its warnings to stderr. Each warning is printed only once per command."""
    for doubt in given.warnings:
        if doubt not in _remarks:
            _remarks.append(doubt)
            complain(doubt)
    return given


def print_json(result: Mapping[str, Any]) -> None:
    """Prints the result of a command as JSON.

    Warnings about vehicles or roads are in the key `remarks`.
    """
    print(json.dumps({**result, **({"remarks": _remarks} if _remarks else {})}, allow_nan=False))


def _page(text: str) -> str:
    """Returns a text of `--help` with wrapped paragraphs.

    Examples are indented. A long example is continued on the next line after a backslash.
    """
    text = re.sub(r"(?<=\S)\n(?=\S)(?!exit code)", " ", text)  # the lines of each paragraph are joined to one line
    lines = [_example(line) if line.startswith("  ") else wrap_text(line, hang=0) for line in text.splitlines()]
    return "\n".join(part for line in lines for part in line)


def _example(line: str) -> list[str]:
    """Returns an example as lines that fit the width of the output and that a user can copy as a whole."""
    return [line] if len(line) <= WIDTH else command(re.split(r" (?=--)", line.strip()))


def _text(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("is empty; give a value or omit the option")
    return text


def _name(text: str) -> str:
    """Returns a name in the Unicode normal form that vehicle files use."""
    return unicodedata.normalize("NFC", _text(text))


def _path(text: str) -> Path:
    from models.common.files import path_from

    return path_from(_text(text))


def _number_in(unit: str) -> Callable[[str], float]:
    """Returns a function that reads a finite number with or without a unit, and converts the number to a given unit."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            from models.common.units import quantity

            try:
                value = quantity(text, unit)
            except InputError as error:
                raise argparse.ArgumentTypeError(str(error)) from None
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"{text!r} is not a finite number; give a finite number")
        return value

    return number
