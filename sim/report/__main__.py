"""`python -m sim.report`: writes one HTML page about a vehicle file and its controllers."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.report.__main__")

from collections.abc import Sequence
from pathlib import Path

from models.common.command import Parser
from models.vehicle.names import LOAD_SYNTAX
from sim.command.road_options import add_road

EPILOG = """
exit code: 0 the report is written; 1 it omits a controller that cannot be designed, or a number of --gallery is not reproduced;
2 invalid input

examples:
  roadproof report --out report.html
  roadproof report --vehicle my_car.toml --controller passive --controller mine --out mine.html --figures figures
  roadproof report --quick --out quick.html
  roadproof report --vehicle my_car.toml --road my_road.csv --speed 15 --duration 30
  roadproof report --quick --vehicle my_car.toml --vehicle van.toml
  roadproof report --vehicle full_car --load brake:g=0.5 --load corner:g=0.3 --out full_car.html
  roadproof report --gallery --out gallery.html
  roadproof report --one-page --vehicle my_car.toml --class C --speed 90km/h --out mail.html
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an option, a vehicle file or an output file is invalid.
    """
    options = _parser().parse_args(arguments)
    from sim.report.command import write_gallery, write_reports

    # Child processes are used only by the command, not if Python code calls `main`
    return write_gallery(options) if options.gallery else write_reports(options, arguments is None)


def _parser() -> Parser:
    parser = Parser("sim.report", "Write one HTML page about a vehicle file and its controllers.", EPILOG)
    parser.add_controller_and_vehicle("default: all but published copies, such as I_printed", "a page for each and one table")
    parser.add_argument("--gallery", action="store_true", help="write the page of published results, not a report")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="file to write the page to (default: report-VEHICLE.html, report-gallery.html)"
    )
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="also write figures (SVG, PNG) and tables (CSV) to this folder"
    )
    parser.add_argument(
        "--one-page", action="store_true", help="write one A4 page with only the comparison over the road (default: class C)"
    )
    parser.add_argument("--quick", action="store_true", help="omit margins, map and ride; takes a few seconds instead of 20 s")
    parser.add_argument(
        "--front",
        metavar="AXES",
        help="add a trade-off between two or three objectives, such as ride:travel, as in `roadproof synth --front`, with "
        "MuJoCo runs of some designs; takes half a minute more",
    )
    parser.add_exported(
        "describe the exported code in this folder, which roadproof synth --export wrote, and its effect on the run"
    )
    add_road(parser, "none")
    parser.add_number("--duration", 20.0, "s", "duration of the run over the road")
    parser.add_loads("add a load on a flat road; with --road or --class it acts there, too", LOAD_SYNTAX)
    parser.add_number("--timestep", 1e-3, "s", "integration step and sample period of the controller")
    printed = parser.add_mutually_exclusive_group()
    printed.add_argument("-v", "--verbose", action="store_true", help="also print every statement of the page")
    printed.add_argument("--brief", action="store_true", help="print only the written files and the comparison of controllers")
    printed.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser
