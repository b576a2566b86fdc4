"""`python -m sim.inspect`: repeats logged runs, and checks the responses, results and certificates in each log."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.inspect.__main__")

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from models.common.command import Parser, complain, print_json
from models.common.errors import InputError
from models.common.printed import Whole, say

EPILOG = """
The command runs the logged vehicle again, compares the signals and results, and checks the certificate of the controller.

exit code: 0 the log still proves its claims; 1 it does not; 2 invalid input; for several logs, the largest code

examples:
  roadproof inspect logs/bump-quarter_car-I-20261121T072417Z.mcap
  roadproof inspect logs/*.mcap
  roadproof inspect LOG.mcap --csv signals.csv
  roadproof inspect LOG.mcap --json
  roadproof inspect hopper.mcap --kinds my_vehicles
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an option is invalid, or the only file is not a log of Roadproof.
    """
    options = _parser().parse_args(arguments)
    from models.document.outputs import check_outputs
    from models.document.text import text_lines
    from sim.inspect.log import read_log
    from sim.inspect.proof import prove
    from sim.inspect.report import RECORD, describe, short_line, write_signals

    kinds, paths, alone = options.kinds, options.logs, len(options.logs) == 1
    if kinds is not None and not kinds.is_dir():
        raise InputError(
            f"--kinds {kinds}: this folder does not exist; give a folder with the .py and .xml files of a vehicle type"
        )
    if options.csv is not None and not alone:
        raise InputError(f"--csv writes the signals of one log, but {len(paths)} are given; give one log, or omit --csv")
    read = [file for ending in ("py", "xml") for file in kinds.glob(f"*.{ending}")] if kinds is not None else []
    check_outputs({"csv": options.csv}, [*paths, *read], options.json)
    objects: list[dict[str, Any]] = []
    code = 0
    for path in paths:
        try:
            proof = prove(read_log(path), kinds)
        except InputError as error:  # an error in one log does not stop the command, which continues with the other logs
            if alone:
                raise
            code = 2
            objects.append({"log": str(path), "proves": False, "error": str(error)})
            complain(str(error))
            continue
        code = max(code, 0 if proof.holds else 1)
        objects.append(RECORD(proof))
        lines = ["csv", Whole(f"  {options.csv}"), ""] if options.csv is not None else []
        if options.csv is not None:
            write_signals(options.csv, proof)
        if alone or options.verbose:
            document = describe(proof, in_table=options.verbose and len(proof.runs) > 1)
            lines += [*text_lines(document, "full" if options.verbose else "normal"), *([] if alone else [""])]
        else:
            lines += short_line(proof)
        if not options.json:
            say(lines)
    hold = sum(one["proves"] for one in objects)
    if options.json:
        result = objects[0] | {"csv": str(options.csv) if options.csv else None} if alone else {"logs": objects}
        print_json(result if alone else result | {"proves": hold == len(paths)})
    elif not alone:
        said = f"{hold} of {len(paths)} logs still prove{'s' * (hold == 1)} what {'it claims' if hold == 1 else 'they claim'}"
        say([said] if options.verbose else ["-v prints every finding", "", said])
    return code


def _parser() -> Parser:
    parser = Parser(
        "sim.inspect",
        "Recompute logged runs from the content of each log, and check whether the log still proves its claims.",
        EPILOG,
    )
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help=".mcap file of a run; one or more")
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="write the signals of one log, as logged and as recomputed by MuJoCo (.csv)"
    )
    parser.add_argument(
        "--kinds",
        type=Path,
        metavar="DIR",
        help="folder of a custom vehicle type; the Python code in this folder is executed (default: none)",
    )
    printed = parser.add_mutually_exclusive_group()
    printed.add_argument("-v", "--verbose", action="store_true", help="print every finding, even for several logs")
    printed.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object and nothing else; for several logs, the object has the keys logs and proves",
    )
    return parser
