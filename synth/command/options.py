"""Options of `python -m synth`, and the rules for combining them."""

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from models.common.command import Parser
from models.common.errors import InputError

MOST_POINTS = 1000  # largest number of a trade-off point that `--point` accepts
AXES_HELP = (
    "ride (body accelerations), travel (suspension deflections), road_holding (tyre deflections), force, band=4-8 (ride between "
    "these frequencies [Hz]) and tolerance=10 (the norm of [performance] with measurement errors of 10 %%). Separate axes by "
    "colons. Each value is a norm from road velocity in SI units. A quarter-car takes 5 to 15 s, with tolerance 20 s"
)

ALONE = {  # options that exclude other options, each with its effect and with the options that can be combined with it
    "check": ("verifies the claims of the given file and designs nothing", ("controller", "picture", "certificates")),
    "rates": ("compares designs at other sample periods", ("controller", "vehicle", "picture")),
    "front": ("designs a trade-off", ("controller", "vehicle", "picture", "csv", "save", "point")),
    "export": ("writes one controller", ("controller", "vehicle", "numbers", "range", "part", "fmi")),
}
EPILOG = """
exit code: 0 every claim holds; 1 a controller could not be designed, or a claim fails; 2 invalid input. If the vehicle file has a
sample period or a delay, an unstable loop fails only if it is unstable both with and without them. A loop that is unstable only
with them is listed and does not fail.

examples:
  roadproof synth
  roadproof synth --vehicle half_car --controller I --json
  roadproof synth --controller I --refine --save my_car.toml
  roadproof synth --check my_car.toml
  roadproof synth --controller I --certificates proofs
  roadproof synth --controller I --export ecu --numbers float
  roadproof synth --export car.mat
  roadproof synth --controller I --export controller.fmu
  roadproof synth --part vehicle --export car.fmu --fmi 3
  roadproof synth --zero-l
  roadproof synth --controller I --fragility
  roadproof synth --vehicle quarter_car_goals --picture bands.png
  roadproof synth --vehicle full_car --cross-check
  roadproof synth --rates 1 2 5 10 20 50 100 --picture rates.png
  roadproof synth --front ride:travel --controller II --picture front.png --csv front.csv
  roadproof synth --front band=4-8:travel:force --save designs.toml --point 20 60
"""


def parse_options(arguments: Sequence[str] | None) -> Namespace:
    """Parses and checks the options.

    Raises:
        InputError: an option is invalid, or two options exclude each other.
    """
    options = _parser().parse_args(arguments)
    if options.cross_check and (options.check or options.refine):
        why = "--check designs nothing" if options.check else "--refine moves the gain away from the optima of these problems"
        raise InputError(
            f"--cross-check solves the LMI problem of each design again, but {why}; omit --cross-check or the other option"
        )
    given = options.given | ({"range"} if options.ranges else set())
    for name, (does, others) in ALONE.items():
        if name in given and given - {name, "json", "verbose", *others}:
            listed = ", ".join(f"--{other}" for other in others)
            raise InputError(f"--{name} {does}; combine it only with {listed} and --json")
    export, front = options.export is not None, options.front is not None
    fmu = export and options.export.suffix.lower() == ".fmu"
    for name, possible, why in (
        ("range", options.numbers in ("int32", "int16"), "--range is for integer code; add --export --numbers int32 or int16"),
        ("numbers", export, "--numbers is for exported code; add --export with a folder"),
        ("part", fmu, "--part is for an FMU; add --export FILE.fmu"),
        ("fmi", fmu, "--fmi is for an FMU; add --export FILE.fmu"),
        ("csv", front, "--csv writes the designs of --front; add --front with its axes"),
        ("point", front, "--point chooses designs of --front; add --front with its axes"),
    ):
        if name in given and not possible:
            raise InputError(f"{why}, or omit --{name}")
    return options


def _parser() -> Parser:
    parser = Parser(
        "synth",
        "Design the controllers of a vehicle file, prove bounds on their norms, and compare them with lower bounds.",
        EPILOG,
    )
    parser.add_controller_and_vehicle("default: all")
    parser.add_argument(
        "--zero-l",
        action="store_true",
        help="set the paper's matrix L to 0 instead of computing it from equation (14); this gives the one-step design of "
        "remark 4",
    )
    parser.add_argument(
        "--refine",
        action="store_true",
        help="after the design, lower the norm further, as long as the gain does not grow too much; print this trade-off",
    )
    parser.add_argument(
        "--cross-check",
        action="store_true",
        help="solve the LMI problems (22) and (25) of the paper again with Clarabel, compare the optima, and check that the "
        "gains attain these optima",
    )
    parser.add_argument(
        "--save", type=Path, metavar="FILE", help="write the vehicle file with each designed gain as controller NAME_designed"
    )
    parser.add_argument(
        "--certificates",
        type=Path,
        metavar="DIR",
        help="write an LMI certificate of each controller to a folder. The folder contains the claims as JSON, and programs in "
        "Python and JavaScript that check these claims in exact arithmetic without Roadproof",
    )
    parser.add_argument("--prove", action="store_true", help="also prove a bound for each law that the vehicle file contains")
    parser.add_argument(
        "--fragility",
        action="store_true",
        help="compute in percent how large errors of measurements and forces may be before the loop becomes unstable or its "
        "norm rises by 1 or 10 %% (a proved limit, and a limit found by search); also compute the norm after the law's "
        "coefficients are rounded to int16 or float16",
    )
    parser.add_argument(
        "--check",
        type=Path,
        metavar="FILE",
        help="verify the gains and certificates in a vehicle file, or the files of a folder that --export wrote",
    )
    parser.add_argument(
        "--export",
        type=Path,
        metavar="DIR",
        help="write one controller to a folder as C99 code with tests, certificate and manifest. With a name "
        "FILE.mat, write controllers for MATLAB. With a name FILE.fmu, write an FMU (see --part)",
    )
    parser.add_argument(
        "--part",
        choices=("controller", "vehicle", "loop"),
        default="controller",
        help="content of the FMU of --export: the digital controller, the linear vehicle, or both as one linear system "
        "(default: controller)",
    )
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="FMI version of the FMU of --export (default: 2)")
    parser.add_argument(
        "--numbers",
        choices=("double", "float", "int32", "int16"),
        default="double",
        help="number format of the code of --export (default: double)",
    )
    parser.add_argument(
        "--range",
        dest="ranges",
        action="append",
        default=[],
        metavar="SIGNAL=NUMBER",
        help="largest magnitude of a measured signal [SI unit], such as sprung_velocity=2; needed with int32 or int16",
    )
    parser.add_numbers("--rates", "ms", "compare sample periods: compute the norm of the sampled-data loop for each")
    parser.add_argument(
        "--front", metavar="AXES", help=f"compute about 200 designs that trade off two or three axes: {AXES_HELP}"
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="draw the frequency responses with the bands of goals shaded, or the result of --rates or --front (.png, .svg or "
        ".pdf); needs matplotlib",
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write all designs of --front (.csv)")
    parser.add_count("--point", "numbers of the designs of --front that --save writes", "all", 1, MOST_POINTS, many=True)
    parser.add_printed("poles, notes and gains of every controller")
    return parser
