"""`python -m sim.campaign FILE`: simulates all combinations that a campaign file describes, and compares the results with
linear predictions.
"""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.campaign.__main__")

from collections.abc import Sequence
from pathlib import Path

from models.common.command import Parser
from models.common.errors import InputError
from models.common.extensions import METRICS
from sim.campaign import HERE, MOST_RUNS
from sim.drive import RUNS_AT_ONCE

MOST_WORKERS = 1024
CHECKS = ("runs", "seed")  # options that are allowed only with --verify
RESULTS = ("picture", "verbose", "brief", "best", "subject_to", "save")  # options that need the results of all runs
RUNS = ("results", "workers", "batch", "ray", "exported", "part", "merge", *RESULTS)
NAMES = {"subject_to": "subject-to", "exported": "as"}

EPILOG = """
A run fails if its control law in Python raises an error, ends its process, or takes longer than 10 s for a call or 100 times real
time. The results then contain the reason. A campaign that was interrupted, even by a power cut, continues when you start the same
command again, also with --part; a few seconds of work are lost. It cannot continue if the file of a control law has changed.

exit code: 0 every run is finished (with --verify: the results are correct); 1 --verify found an error, a controller cannot be
designed, or no controller is within the limits of --subject-to; 2 invalid input or a full disk; 130 interrupted: finished runs
are kept

examples:
  roadproof campaign campaign.toml
  roadproof campaign campaign.toml --results /data/campaign --workers 8 --json
  roadproof campaign campaign.toml --ray auto
  roadproof campaign campaign.toml --part 3/40
  roadproof campaign campaign.toml --merge
  roadproof campaign campaign.toml --best ride --subject-to peak_travel:0.08 --save tuned.toml
  roadproof campaign --verify campaign-results
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an option, the campaign file or the results folder is invalid, or the disk is full.
    """
    options = _parser().parse_args(arguments)
    if options.verify is None and options.file is None:
        raise InputError(
            "the campaign file is missing; give a TOML file that describes the campaign, or --verify with a folder of results"
        )
    for name in CHECKS if options.verify is None else RUNS:
        if name in options.given or (name == "subject_to" and options.subject_to):
            which = "needs --verify" if name in CHECKS else "cannot be combined with --verify"
            raise InputError(f"--{NAMES.get(name, name)} {which}; omit --{NAMES.get(name, name)}")
    for option, others in {"part": ("merge", *RESULTS), "merge": ("workers", "batch", "ray", "exported")}.items():
        for name in others if option in options.given else ():
            if name in options.given or (name == "subject_to" and options.subject_to):
                raise InputError(f"--{NAMES.get(name, name)} cannot be combined with --{option}; omit --{NAMES.get(name, name)}")
    from sim.campaign.command import check_results, run_campaign, run_part

    if options.part is not None:
        return run_part(options)
    return run_campaign(options) if options.verify is None else check_results(options)


def _parser() -> Parser:
    parser = Parser(
        "sim.campaign", "Simulate all combinations in a campaign file, and compare the results with linear predictions.", EPILOG
    )
    parser.add_argument("file", type=Path, nargs="?", metavar="FILE", help="campaign file (TOML)")
    parser.add_argument(
        "--results", type=Path, metavar="DIR", help="folder of the results (default: campaign-results for campaign.toml)"
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="plot ride against road holding, with a point for each controller (.png, .svg or .pdf)",
    )
    parser.add_argument(
        "--best",
        metavar="METRIC",
        help="find the controller, or the variant of a law with sampled parameters, that has the smallest value of this metric "
        f"over all runs; the metric is one of {', '.join(METRICS)}, or a metric column of the results",
    )
    parser.add_argument(
        "--subject-to",
        action="append",
        metavar="METRIC:LIMIT",
        help="largest allowed value of a metric that --best does not minimise, in SI units (m, m/s2, N; fractions of time from 0 "
        "to 1), for example peak_travel:0.08; may be repeated",
    )
    parser.add_exported()
    parser.add_argument("--save", type=Path, metavar="FILE", help="write a vehicle file with the best controller")
    parser.add_count("--workers", "number of threads that simulate", "one per core", 1, MOST_WORKERS)
    parser.add_count("--batch", "largest number of runs that are saved together", "a few seconds of work", 1, RUNS_AT_ONCE)
    parser.add_argument(
        "--ray",
        nargs="?",
        const=HERE,
        metavar="ADDRESS",
        help="run on a Ray cluster; give HOST:PORT of the cluster's head, or auto; without ADDRESS, Ray uses the cores of this "
        "machine",
    )
    parser.add_argument(
        "--part",
        metavar="K/N",
        help="run only part K of N parts, for example as a job of a cluster; parts may run at the same time if they share the "
        "folder of the results",
    )
    parser.add_argument("--merge", action="store_true", help="combine the finished parts into the results of the whole campaign")
    parser.add_argument(
        "--verify",
        type=Path,
        metavar="DIR",
        help="check a folder of finished results: compare checksums and the inputs of each row, and repeat some runs",
    )
    parser.add_count("--runs", "number of runs that --verify repeats", "16", 1, MOST_RUNS, 16)
    parser.add_count("--seed", "seed of the random choice of these runs", "0", 0, 2**63 - 1, 0)
    parser.add_printed("a table for each road and speed", "print only the comparison of controllers over all runs")
    return parser
