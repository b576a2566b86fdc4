"""The options of `python -m synth`, and which of them go together."""

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from models.common.command import Parser
from models.common.errors import InputError

MOST_POINTS = 1000  # that `--point` can name
AXES_HELP = (
    "ride (body accelerations), travel (suspension deflections), road_holding (tyre deflections), force, band=4-8 (ride within "
    "these Hz) and tolerance=10 (the norm of [performance] with readings off by so many per cent), a colon between them; each is "
    "the norm from road velocity, in SI; the quarter-car takes 5 to 8 s, with tolerance 20 s"
)

EPILOG = """
exit code: 0 every claim holds, 1 a controller could not be designed or a claim fails, 2 bad input. With a sample period or a
delay in the vehicle file a loop fails as unstable only if it is unstable with these and without. A loop that is unstable with
these alone is named, and does not fail

examples:
  python -m synth
  python -m synth --vehicle half_car --controller I --json
  python -m synth --controller I --refine --save my_car.toml
  python -m synth --check my_car.toml
  python -m synth --controller I --export ecu --numbers float
  python -m synth --export car.mat
  python -m synth --controller I --export controller.fmu
  python -m synth --part vehicle --export car.fmu --fmi 3
  python -m synth --zero-l
  python -m synth --controller I --fragility
  python -m synth --vehicle quarter_car_goals --picture bands.png
  python -m synth --vehicle full_car --cross-check
  python -m synth --rates 1 2 5 10 20 50 100 --picture rates.png
  python -m synth --front ride:travel --controller II --picture front.png --csv front.csv
  python -m synth --front band=4-8:travel:force --save designs.toml --point 20 60
"""


def parse_options(arguments: Sequence[str] | None) -> Namespace:
    """Parses and checks the options.

    Raises:
        InputError: bad options, or options that exclude each other.
    """
    options = _parser().parse_args(arguments)
    if options.cross_check and (options.check or options.refine):
        why = "--check designs nothing" if options.check else "--refine leaves their optima"
        raise InputError(f"--cross-check solves the LMI problems of designs again, and {why}; omit one of them")
    if options.check and options.given & {"zero_l", "refine", "save", "vehicle", "prove", "fragility"}:
        raise InputError("--check reads its own file and designs nothing; it goes with --controller, --picture and --json only")
    if options.rates and options.given & {"zero_l", "refine", "save", "check", "cross_check", "prove", "fragility"}:
        raise InputError("--rates takes designs as they are; it goes with --controller, --vehicle, --picture and --json only")
    if options.front is not None and options.given & {"zero_l", "refine", "check", "cross_check", "prove", "rates", "fragility"}:
        raise InputError(
            "--front designs a trade-off; it goes with --controller, --vehicle, --picture, --csv, --save, --point and --json only"
        )
    others = {"zero_l", "refine", "save", "check", "cross_check", "prove", "rates", "fragility", "front", "picture"}
    if options.export is not None and options.given & others:
        raise InputError(
            "--export writes one controller; it goes with --controller, --vehicle, --numbers, --range, --part, --fmi and --json "
            "only"
        )
    if options.ranges and options.numbers not in ("int32", "int16"):
        raise InputError("--range is of integers; give --export with --numbers int32 or int16, or omit it")
    if options.export is None and "numbers" in options.given:
        raise InputError("--numbers is of the code of --export; name its folder with --export, or omit it")
    fmu = options.export is not None and options.export.suffix.lower() == ".fmu"
    for name in ("part", "fmi"):
        if not fmu and name in options.given:
            raise InputError(f"--{name} is of an FMU; name its file with --export FILE.fmu, or omit it")
    for name in ("csv", "point"):
        if options.front is None and name in options.given:
            raise InputError(f"--{name} is of the designs of --front; give its axes with --front, or omit it")
    return options


def _parser() -> Parser:
    parser = Parser(
        "synth",
        "Designs the controllers of a vehicle file, proves bounds on their norms, and compares them with lower bounds.",
        EPILOG,
    )
    parser.add_controller_and_vehicle("default: all")
    parser.add_argument("--zero-l", action="store_true", help="L = 0 instead of equation (14), the one-step design of remark 4")
    parser.add_argument(
        "--refine",
        action="store_true",
        help="then lower the norm itself, as long as it is worth a larger gain; print the trade-off",
    )
    parser.add_argument(
        "--cross-check",
        action="store_true",
        help="solve (22) and (25) by Clarabel, too: how far apart the optima are, and whether the gain attains both",
    )
    parser.add_argument(
        "--save", type=Path, metavar="FILE", help="write the vehicle file with each designed gain added, as NAME_designed"
    )
    parser.add_argument(
        "--prove", action="store_true", help="prove a bound for every law that the vehicle file gives, too, as for designed ones"
    )
    parser.add_argument(
        "--fragility",
        action="store_true",
        help="find how far, in per cent, measurements and forces may be off until the loop is unstable, or its norm 1 or "
        "10 %% higher: proved, and found; and the effect of rounding its numbers to int16 or float16",
    )
    parser.add_argument(
        "--check",
        type=Path,
        metavar="FILE",
        help="verify the gains of a vehicle file and their certificates, or a folder of --export, file by file",
    )
    parser.add_argument(
        "--export",
        type=Path,
        metavar="DIR",
        help="write one controller as C99 with tests, certificate and manifest; to FILE.mat, controllers for MATLAB; to "
        "FILE.fmu, what --part says as an FMU",
    )
    parser.add_argument(
        "--part",
        choices=("controller", "vehicle", "loop"),
        default="controller",
        help="what an FMU of --export is: a controller as its computer runs it, the linear vehicle, or both as one linear system "
        "(default: controller)",
    )
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="version of FMI of an FMU of --export (default: 2)")
    parser.add_argument(
        "--numbers",
        choices=("double", "float", "int32", "int16"),
        default="double",
        help="numbers of the code of --export (default: double)",
    )
    parser.add_argument(
        "--range",
        dest="ranges",
        action="append",
        default=[],
        metavar="SIGNAL=NUMBER",
        help="largest magnitude of a reading, in SI units; for int32 and int16, which need one for each",
    )
    parser.add_numbers("--rates", "ms", "what computers of these sample periods cost: norms of the loops as they run them")
    parser.add_argument("--front", metavar="AXES", help=f"about 200 designs between two or three of {AXES_HELP}")
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="draw the responses over frequency, the bands of goals shaded, or what --rates or --front asks for, as .png or "
        ".svg; needs matplotlib",
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write every design of --front")
    parser.add_count("--point", "the designs of --front that --save writes", "all", 1, MOST_POINTS, many=True)
    parser.add_printed("poles, proofs, notes and gains of every controller, and which gains are not unique")
    return parser
