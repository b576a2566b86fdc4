"""The command `sim.campaign`: runs a campaign, or checks a finished one."""

import argparse
import json
import sys
from contextlib import nullcontext
from pathlib import Path

from models.common.command import complain, versions
from models.common.errors import InputError, listing
from models.common.files import read_text
from models.common.printed import Stages, Whole, say
from models.common.threads import cores
from models.figures.outputs import check_outputs, written, written_lines
from models.figures.picture import write_picture
from sim.campaign import MOST_RUNS
from sim.campaign.best import choose, requested, save
from sim.campaign.columns import columns, described
from sim.campaign.controllers import check_code, designed, designed_at_start, drawn_laws
from sim.campaign.file import Campaign, parse_campaign, read_campaign
from sim.campaign.manifest import FaultError, Gains, Manifest, check_same, digest, gains_of, locked, read_manifest
from sim.campaign.plan import Plan, Progress
from sim.campaign.store import Store
from sim.campaign.summary import compare, compared_lines, compared_object, short_lines, summarise, summary_lines, trade_off
from sim.campaign.verify import Verified, verify
from sim.campaign.workers import Rows, cluster, run_batches
from sim.physics import RUNS_AT_ONCE

FINISHED = "give a folder of a finished campaign's results"
LEFT_OUT = (
    "of the runs that were drawn {count} are of laws in Python and were not driven again: their code is run only for a campaign "
    "file that you name, as in --verify DIR FILE"
)
NUMBERS = ("roadproof", "mujoco", "numpy", "scipy")  # packages whose versions decide the numbers


def run_campaign(options: argparse.Namespace) -> int:
    """Runs the missing part of a campaign and prints the results; returns the exit code.

    Raises:
        InputError: a bad campaign file or results folder, options that do not go together, or a disk that is full.
    """
    campaign = read_campaign(options.file)
    for road in campaign.roads:
        if road.profile is not None and (remark := road.profile.gap(max(campaign.speeds) * campaign.duration)):
            complain(f"remark: road {road.text!r}: {remark}")
    request = requested(campaign, options.best, options.subject_to or (), options.save)
    outputs = {"picture": options.picture, "save": options.save}
    check_outputs(
        outputs, [options.file, *(file for vehicle in campaign.vehicles.values() for file in vehicle.files)], options.json
    )
    folder = options.results or options.file.with_name(f"{options.file.stem}-results")
    if options.ray is not None and "workers" in options.given:
        raise InputError("--workers are threads of this machine, and --ray has workers of its own; omit one of them")
    workers = options.workers or cores()
    with cluster(options.ray) if options.ray is not None else nullcontext(), locked(folder):
        stage = Stages("designs", "runs", "results")
        stage("designs")
        plan, manifest = _plan(campaign, folder, options.file, options.exported)
        store = _store(plan, folder, manifest)
        store.tidy()
        for remark in store.damaged:
            print(f"roadproof: {remark}", file=sys.stderr)
        gaps = store.missing()
        stage("runs")
        progress = Progress(plan, sum(stop - start for start, stop in gaps), options.batch or RUNS_AT_ONCE, stage)

        def write(start: int, rows: Rows, took: float) -> None:
            store.write(start, rows)
            progress.add(len(rows), took)

        try:
            run_batches(plan, plan.batches(gaps, progress.next_batch), workers, options.ray is not None, write)
        except KeyboardInterrupt:
            stage.end()
            left = sum(stop - start for start, stop in store.missing())
            message = f"interrupted: {plan.count - left} of {plan.count} runs are kept; start it again to go on"
            raise KeyboardInterrupt(message) from None
        stage("results")
        store.finish()
        entries, standings = summarise(plan, store), compare(plan, store)
        choices = choose(plan, store, request, standings) if request is not None else []
        within = all(choice.within for choice in choices)
        if options.save is not None and within:
            saved = save(options.save, campaign, choices[0], options.command_line, manifest.digest)
        else:
            saved, outputs["save"] = None, None
        if options.picture is not None:
            figure = trade_off(plan, entries)
            if figure is not None:
                write_picture(figure, options.picture)
            else:
                outputs["picture"] = None
        stage.end()
        if outputs["picture"] is not options.picture:
            complain("--picture: no run of the campaign has both ride and tyre load; there is nothing to draw")
        if options.json:
            result = {
                "results": str(store.results),
                "runs": plan.count,
                "new": progress.done,
                "damaged": store.damaged,
                "summary": entries,
                "compared": compared_object(standings),
                "best": [choice.record for choice in choices],
                "saved_controller": saved,
                **written(outputs),
            }
            print(json.dumps(result, allow_nan=False))
        else:
            now = f"{progress.done} of them now: {progress.rate:.3g} steps/s" if progress.done else "all of them there already"
            lines = [f"{plan.count} runs of {campaign.duration:g} s at {campaign.timestep:g} s, {now}"]
            coded = {
                f"{name} in {one['code']['numbers']}"
                for some in manifest.controllers.values()
                for name, one in some.items()
                if "code" in one
            }
            lines += [f"compiled code drives {listing(coded)}"] if coded else []
            say(
                [
                    *lines,
                    "",
                    "results",
                    Whole(f"  {store.results}"),
                    *([] if options.brief else (summary_lines if options.verbose else short_lines)(entries)),
                    *written_lines(outputs),
                    *compared_lines(standings, {choice.vehicle: choice.candidate for choice in choices}),
                    *(["", *(choice.line for choice in choices)] if choices else []),
                    *([f"saved as controller {saved}"] if saved is not None else []),
                ]
            )
    return 0 if within else 1


def check_results(options: argparse.Namespace) -> int:
    """Checks a finished campaign and prints the findings; returns the exit code.

    Raises:
        InputError: an option that does not go with it; there is no finished campaign, or it cannot be read here.
    """
    for name in ("results", "workers", "batch", "ray", "picture", "verbose", "brief", "best", "subject_to", "save"):
        if name in options.given or (name == "subject_to" and options.subject_to):
            raise InputError(f"--verify runs no campaign and cannot be combined with --{name.replace('_', '-')}; omit it")
    folder = options.verify
    if not folder.is_dir():
        raise InputError(f"--verify {folder}: there is no such folder; give the results folder of a finished campaign")
    try:
        runs, verified, remark = _found(options, folder)
    except FaultError as error:
        runs, verified, remark = None, Verified(0, (), (str(error),)), ""
    if options.json:
        result = {"results": str(folder), "runs": runs, "rows": verified.rows, "seed": options.seed, "remark": remark}
        print(json.dumps({**result, "again": verified.again, "faults": verified.faults, "holds": not verified.faults}))
        return 1 if verified.faults else 0
    if remark:
        say([remark])
    say(["results", Whole(f"  {folder}")])
    if verified.faults:
        say([*verified.faults, "", "the results DO NOT HOLD what the campaign comes to"])
    else:
        say(
            [
                f"each of {verified.rows} runs has its row, with its inputs; {len(verified.again)} of them, drawn with seed "
                f"{options.seed}, were driven again and are the same bit for bit",
                "",
                "the results hold what the campaign comes to",
            ]
        )
    return 1 if verified.faults else 0


def _found(options: argparse.Namespace, folder: Path) -> tuple[int, Verified, str]:
    """Returns the number of runs, the result of --verify, and a remark on the campaign file."""
    manifest = read_manifest(folder, FINISHED)
    if manifest is None:
        raise InputError(f"--verify {folder}: is empty; {FINISHED}")
    remark = ""
    if options.file is not None:
        campaign = read_campaign(options.file)
    else:
        file = Path(manifest.file)
        if not file.is_absolute() or not file.parent.is_dir():  # the folder was copied to another machine
            file = folder.absolute().parent / file.name
        try:  # what the folder names is no code that anybody has asked for, be it a law or a kind of vehicle
            campaign = parse_campaign(manifest.campaign, file, own_kinds=False)
        except InputError as error:
            raise InputError(f"{error}; where you trust what it names, give the file too: --verify {folder} FILE") from error
        try:
            same = read_text(file, "campaign file", "") == manifest.campaign
            remark = "" if same else f"campaign file {file} is another one by now; the folder's own text of it counts"
        except InputError:
            remark = f"campaign file {file} is not there any more; the folder's own text of it counts"
        if manifest.digest != digest(campaign.sources):
            raise FaultError(
                f"results {folder}: the campaign's text, or a vehicle or road file that it names, is not what it was when the "
                "campaign began"
            )
    check_same(manifest, folder, campaign.sources, _versions(), described(campaign), FINISHED)
    plan = _planned(campaign, manifest.controllers, folder)
    stage = Stages("rows", "runs driven again")
    stage("rows")
    store = _store(plan, folder, manifest)
    own = options.file is not None
    verified = verify(plan, store, options.runs, options.seed, own, stage.counted("runs driven again", options.runs, "runs"))
    stage.end()
    if verified.left_out:
        remark = "; ".join(filter(None, [remark, LEFT_OUT.format(count=verified.left_out)]))
    return plan.count, verified, remark


def _plan(campaign: Campaign, folder: Path, file: Path, exported: Path | None) -> tuple[Plan, Manifest]:
    """The runs with the gains that the campaign began with, designed now where it begins; and what the folder says of them."""
    count = Plan(campaign, {}).count
    if count > MOST_RUNS:
        raise InputError(f"{count} runs are too many; at most {MOST_RUNS}")
    manifest, used = read_manifest(folder), _versions()
    if manifest is None:
        gains = gains_of(designed(campaign, exported))
        about = described(campaign)
        manifest = Manifest(str(file.absolute()), digest(campaign.sources), used, campaign.text, gains, about, count)
        manifest.write(folder)
    check_same(manifest, folder, campaign.sources, used, described(campaign))
    if exported is not None:
        check_code(manifest.controllers, exported)
    return _planned(campaign, manifest.controllers, folder), manifest


def _planned(campaign: Campaign, gains: Gains, folder: Path) -> Plan:
    return Plan(campaign, designed_at_start(campaign, gains, folder), drawn_laws(campaign))


def _store(plan: Plan, folder: Path, manifest: Manifest) -> Store:
    about = {"campaign": plan.campaign.text, "versions": json.dumps(versions()), "controllers": json.dumps(manifest.controllers)}
    return Store(folder, columns(plan.campaign), about, manifest.runs)


def _versions() -> dict[str, str]:
    """Returns the versions of the packages that decide the numbers."""
    return {name: version for name, version in versions().items() if name in NUMBERS}
