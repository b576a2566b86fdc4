"""`python -m sim.campaign FILE`: every combination of what a file names, in MuJoCo, beside its linear prediction."""

import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from models.command import Parser, run_command
from models.errors import InputError
from sim.campaign_batch import Plan, columns
from sim.campaign_file import MOST_RUNS, Campaign, read_campaign
from sim.campaign_store import Store, begin, begun, controllers_text, held
from sim.campaign_summary import summarise, summary_lines
from sim.campaign_workers import Rows, run_batches
from sim.physics import RUNS_AT_ONCE
from sim.progress import show
from sim.provenance import versions
from synth.controller import Controller, Designer, given

NUMBERS = ("roadproof", "mujoco", "numpy", "scipy")  # packages whose versions decide the numbers

EPILOG = """
Interrupted, by Ctrl-C, kill -9 or a power cut, and started again, it goes on where it was.
exit code: 0 every run is there, 2 bad input or a full disk, 130 interrupted: what is done is kept

examples:
  python -m sim.campaign campaign.toml
  python -m sim.campaign campaign.toml --results /data/campaign --workers 8 --json
  python -m sim.campaign campaign.toml --ray auto
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, campaign file, results folder, or a disk that is full.
    """
    options = _parser().parse_args(arguments)
    for name in ("workers", "batch"):
        if getattr(options, name) < 0:
            raise InputError(f"{name} = {getattr(options, name)} is not allowed; give a whole number above 0")
    campaign = read_campaign(options.file)
    folder = options.results or options.file.with_name(f"{options.file.stem}-results")
    with held(folder):
        used = {name: version for name, version in versions().items() if name in NUMBERS}
        plan = _plan(campaign, folder, used)
        metadata = {"campaign": campaign.text, "versions": json.dumps(versions()), "controllers": _gains(plan)}
        store = Store(folder, columns(plan), metadata, plan.count)
        batches = [batch for gap in store.missing() for batch in plan.batches(*gap, options.batch or RUNS_AT_ONCE)]
        progress = _Progress(plan, sum(end - start for start, end in batches))

        def write(start: int, rows: Rows) -> None:
            store.write(start, rows)
            progress.add(len(rows))

        try:
            run_batches(
                plan, batches, options.workers or os.cpu_count() or 1, options.ray or None, options.ray is not None, write
            )
        except KeyboardInterrupt:
            show("")
            left = sum(end - start for start, end in store.missing())
            print(f"roadproof: {plan.count - left} of {plan.count} runs are kept; start it again to go on", file=sys.stderr)
            raise
        show("")
        store.finish()
        entries = summarise(plan, store)
        if options.json:
            result = {"results": str(store.results), "runs": plan.count, "new": progress.done, "summary": entries}
            print(json.dumps(result, allow_nan=False))
        else:
            rate = (
                f", {progress.done} of them now: {progress.rate:.3g} steps/s" if progress.done else ", all of them there already"
            )
            lines = [f"{plan.count} runs of {campaign.duration:g} s at {campaign.timestep:g} s{rate}", *summary_lines(entries)]
            print("\n".join([*lines, "", f"results {store.results}"]))
    return 0


def _plan(campaign: Campaign, folder: Path, used: Mapping[str, str]) -> Plan:
    """The runs, with the gains of the first start, or of this one, if it is that.

    Raises:
        InputError: the folder holds another campaign; a controller cannot be designed; far too many runs.
    """
    count = Plan(campaign, {}).count
    if count > MOST_RUNS:
        raise InputError(f"{count} runs are too many; at most {MOST_RUNS}")
    manifest = begun(folder, campaign.sources, used)
    designed: dict[str, dict[str, Controller]] = {}
    if manifest is None:
        for name, vehicle in campaign.vehicles.items():
            designer = Designer(vehicle)
            designed[name] = {controller: designer.design(controller) for controller in campaign.controllers}
        manifest = begin(folder, campaign.sources, used, campaign.text, controllers_text(designed))
    for name, entries in manifest["controllers"].items():
        vehicle = campaign.vehicles[name]
        designed[name] = {controller: given(vehicle, controller, **entry) for controller, entry in entries.items()}
    return Plan(campaign, designed)


def _gains(plan: Plan) -> str:
    return json.dumps(controllers_text(plan.controllers))


class _Progress:
    """How many runs are done, how fast, and how long it will take."""

    def __init__(self, plan: Plan, total: int) -> None:
        self.steps, self.total, self.done, self.began = len(plan.campaign.time), total, 0, time.monotonic()

    @property
    def rate(self) -> float:
        """Run-steps a second."""
        return self.done * self.steps / max(time.monotonic() - self.began, 1e-9)

    def add(self, runs: int) -> None:
        """Shows that some more are done."""
        self.done += runs
        left = (self.total - self.done) * self.steps / self.rate
        clock = f"{int(left // 3600)}:{int(left // 60 % 60):02d}:{int(left % 60):02d}"
        show(f"{self.done} of {self.total} runs, {self.rate:.3g} steps/s, {clock} left")


def _parser() -> Parser:
    parser = Parser(
        "sim.campaign", "Runs every combination that a campaign file names, and compares with linear predictions.", EPILOG
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="campaign file (TOML)")
    parser.add_argument(
        "--results", type=Path, metavar="DIR", help="folder of the results (default: FILE without .toml, and -results)"
    )
    parser.add_argument("--workers", type=int, default=0, metavar="N", help="threads that run batches (default: one per core)")
    parser.add_argument(
        "--batch", type=int, default=0, metavar="N", help="most runs in a batch (default: what the memory allows)"
    )
    parser.add_argument(
        "--ray",
        nargs="?",
        const="",
        metavar="ADDRESS",
        help="run on a Ray cluster (default address: one of this machine's cores)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


if __name__ == "__main__":
    run_command(main)
