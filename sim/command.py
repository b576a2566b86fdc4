"""What all commands share: one line per mistake, exit codes, a clean Ctrl-C."""

import argparse
import math
import os
import sys
from collections.abc import Callable
from typing import Any, NoReturn

from models.errors import InputError

BAD_INPUT = 2


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose help shows defaults and whose errors are one line."""

    def __init__(self, prog: str, description: str, epilog: str = "") -> None:
        super().__init__(
            prog=f"python -m {prog}",
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def error(self, message: str) -> NoReturn:
        """Bad options: one line, exit code 2."""
        raise InputError(f"{message}; see {self.prog} --help")

    def add_number(self, option: str, default: float, unit: str, meaning: str) -> None:
        """An option that takes a finite number."""
        self.add_argument(option, type=_number, default=default, metavar=unit, help=f"{meaning} [{unit}] (default: {default:g})")


def run_command(main: Callable[[], int]) -> NoReturn:
    """Runs a command and exits as every command does: its own code, 2 on bad input, 130 on Ctrl-C."""
    try:
        code = main()
        sys.stdout.flush()
    except InputError as error:
        print(f"roadproof: {error}", file=sys.stderr)
        code = BAD_INPUT
    except KeyboardInterrupt:
        print("roadproof: interrupted", file=sys.stderr)
        code = 130
    except BrokenPipeError:  # the reader has gone, as in `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code)


def _number(text: str) -> Any:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value
