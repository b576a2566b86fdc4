"""The command `sim.campaign`: runs a campaign, or checks a finished one."""

import argparse
import json
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from models.common.command import complain, print_json, versions
from models.common.errors import InputError, listing
from models.common.files import read_text
from models.common.printed import Stages, Whole, say
from models.common.threads import cores
from models.document.document import Document
from models.document.outputs import check_outputs, written, written_lines
from models.document.picture import write_picture
from models.document.text import text_lines
from models.roads.opencrg import Surface
from models.roads.profile import Profile
from sim.campaign import MOST_RUNS
from sim.campaign.best import choose, requested, save
from sim.campaign.columns import columns
from sim.campaign.controllers import check_code, designed, planned
from sim.campaign.file import Campaign, parse_campaign, read_campaign
from sim.campaign.manifest import Manifest, gains_of, locked, read_manifest
from sim.campaign.plan import RATE, Plan, Progress
from sim.campaign.store import Store
from sim.campaign.summary import compare, compared_lines, describe, summarise, trade_off
from sim.campaign.verify import verify
from sim.campaign.workers import Rows, cluster, run_batches
from sim.drive import RUNS_AT_ONCE
from sim.studies.ride.standing import standings_object

FINISHED = "give the folder with the results of a finished campaign"
MOST_OF_A_RUN = 0.99  # on a road from a file
NUMBERS = ("roadproof", "mujoco", "numpy", "scipy")  # packages whose versions decide the numbers


def run_campaign(options: argparse.Namespace) -> int:
    """Runs the missing part of a campaign and prints the results; returns the exit code.

    Raises:
        InputError: a bad campaign file or results folder, options that do not go together, or a disk that is full.
    """
    campaign = read_campaign(options.file)
    first, fastest, lasts = next(iter(campaign.vehicles.values())), max(campaign.speeds), campaign.duration
    for road in campaign.roads:
        if road.profile is not None and (remark := road.profile.remark(max(campaign.speeds) * campaign.duration)):
            complain(f"remark: road {road.text!r}: {remark}")
        if (
            isinstance(road.road, Profile | Surface)
            and road.build(first, fastest, 0, fastest * lasts).duration < MOST_OF_A_RUN * lasts
        ):
            after = "it is straight from there on, which lowers every rms"
            complain(f"remark: road {road.text!r} ends before a run of {lasts:g} s at {fastest:g} m/s does; {after}")
    request = requested(campaign, options.best, options.subject_to or (), options.save)
    read = [options.file, *(file for vehicle in campaign.vehicles.values() for file in vehicle.files)]
    check_outputs({"picture": options.picture, "save": options.save}, read, options.json)
    folder = options.results or options.file.with_name(f"{options.file.stem}-results")
    if options.ray is not None and "workers" in options.given:
        raise InputError("--workers sets threads of this machine, but --ray uses the workers of a cluster; omit one of the two")
    workers = options.workers or cores()
    with cluster(options.ray) if options.ray is not None else nullcontext(), locked(folder):
        stage = Stages("designs", "runs", "results")
        stage("designs")
        manifest = _begun(campaign, folder, options.file, options.exported)
        plan, store = _plan(campaign, manifest, folder)
        store.tidy()
        for remark in store.damaged:
            print(f"roadproof: {remark}", file=sys.stderr)
        stage("runs")
        progress = Progress(plan, store.left, options.batch or RUNS_AT_ONCE, stage)

        def write(start: int, rows: Rows, took: float) -> None:
            store.write(start, rows)
            progress.add(len(rows), took)

        try:
            run_batches(plan, plan.batches(store.missing(), progress.next_batch), workers, options.ray is not None, write)
        except KeyboardInterrupt:
            stage.end()
            message = f"interrupted: {plan.count - store.left} of {plan.count} runs are kept; repeat the command to continue"
            raise KeyboardInterrupt(message) from None
        stage("results")
        store.finish()
        entries, standings = summarise(plan, store), compare(plan, store)
        choices = [choose(plan, store, request, vehicle) for vehicle in campaign.vehicles] if request is not None else []
        within = all(choice.within for choice in choices)
        figure = trade_off(plan, entries, standings) if options.picture is not None else None
        saved = None
        if options.save is not None and within:
            saved = save(options.save, campaign, choices[0], options.command_line, manifest.digest)
        if figure is not None and options.picture is not None:
            write_picture(figure, options.picture)
        stage.end()
    if options.picture is not None and figure is None:
        complain("--picture: no picture is drawn, because no run of the campaign has both ride and tyre load")
    outputs = {"picture": options.picture if figure is not None else None, "save": options.save if saved is not None else None}
    if options.json:
        result = {
            "results": str(store.results),
            "runs": plan.count,
            "settle": campaign.settle,
            "new": progress.done,
            "damaged": store.damaged,
            "summary": entries,
            "compared": [{"vehicle": name, **standings_object([*some.values()])} for name, some in standings.items()],
            "best": [choice.record for choice in choices],
            "saved_controller": saved,
            **written(outputs),
        }
        print_json(result)
        return 0 if within else 1
    now = f"{progress.done} of them simulated now, {RATE.text(progress.rate)}" if progress.done else "all simulated before"
    lines = [f"{plan.count} runs of {campaign.duration:g} s at {campaign.timestep:g} s, {now}"]
    gains = [entry for some in manifest.controllers.values() for entry in some.items()]
    coded = {f"{name} in {one['code']['numbers']}" for name, one in gains if "code" in one}
    lines += [f"controllers that run as compiled code: {listing(coded)}"] if coded else []
    lines += ["", "results", Whole(f"  {store.results}")]
    if not options.brief:
        lines += ["", *text_lines(describe(entries), "full" if options.verbose else "normal")]
        lines += [] if options.verbose else ["-v adds ride, travel and load on each road: rms, 95th percentile, prediction"]
    lines += written_lines(outputs)
    lines += compared_lines(campaign, standings, {choice.vehicle: choice.candidate for choice in choices})
    lines += ["", *text_lines(Document("", tuple(choice.statement for choice in choices)))] if choices else []
    lines += [f"saved as controller {saved}"] if saved is not None else []
    say(lines)
    return 0 if within else 1


def check_results(options: argparse.Namespace) -> int:
    """Checks a finished campaign and prints the findings; returns the exit code.

    Raises:
        InputError: there is no finished campaign, or it cannot be read here.
    """
    folder = options.verify
    runs, verified, remark = _found(options, folder)
    faults, again = verified["faults"], len(verified["again"])
    if options.json:
        about = {"results": str(folder), "runs": runs, "rows": verified["rows"], "seed": options.seed, "remark": remark}
        print_json({**about, **verified, "holds": not faults})
        return 1 if faults else 0
    found = [*faults, "", "the results DO NOT AGREE with the campaign"]
    if not faults:
        said = f"{again} runs, chosen with seed {options.seed}, were repeated and gave the same numbers"
        found = [f"each of the {verified['rows']} runs has one row with its inputs; {said}"]
        found += ["", "the results agree with the campaign"]
    say([*filter(None, [remark]), "results", Whole(f"  {folder}"), *found])
    return 1 if faults else 0


def _found(options: argparse.Namespace, folder: Path) -> tuple[int, dict[str, Any], str]:
    """Returns the number of runs, the result of --verify, and a remark on the campaign file."""
    manifest = read_manifest(folder, FINISHED) if folder.is_dir() else None
    if manifest is None:
        raise InputError(f"--verify {folder}: this folder contains no campaign; {FINISHED}")
    remark = ""
    if options.file is not None:
        campaign = read_campaign(options.file)
    else:
        file = Path(manifest.file)
        if not file.is_absolute() or not file.parent.is_dir():  # the folder was copied to another machine
            file = folder.absolute().parent / file.name
        campaign = parse_campaign(manifest.campaign, file)
        now = "has changed" if file.is_file() else "no longer exists"
        if not file.is_file() or read_text(file, "campaign file", "") != manifest.campaign:
            remark = f"the campaign file {file} {now}; the copy in the folder of results is used"
    manifest.check(folder, campaign.digest, _versions(), FINISHED)
    plan, store = _plan(campaign, manifest, folder)
    stage = Stages("rows", "repeated runs")
    stage("rows")
    progress = stage.counted("repeated runs", options.runs, "runs")
    verified = verify(plan, store, manifest.controllers, options.runs, options.seed, progress)
    stage.end()
    return plan.count, verified, remark


def _begun(campaign: Campaign, folder: Path, file: Path, exported: Path | None) -> Manifest:
    """Returns the manifest in a folder, which is made, with gains designed now, if the campaign begins now."""
    count = Plan(campaign, {}).count
    if count > MOST_RUNS:
        raise InputError(f"the campaign has {count} runs, but at most {MOST_RUNS} are allowed; list fewer seeds or samples")
    manifest, used = read_manifest(folder), _versions()
    if manifest is None:
        gains = gains_of(designed(campaign, exported))
        manifest = Manifest(str(file.absolute()), campaign.digest, used, campaign.text, gains, count)
        manifest.write(folder)
    manifest.check(folder, campaign.digest, used)
    if exported is not None:
        check_code(manifest.controllers, exported)
    return manifest


def _plan(campaign: Campaign, manifest: Manifest, folder: Path) -> tuple[Plan, Store]:
    """Returns the runs with the gains that the campaign began with, and their results."""
    about = {"campaign": campaign.text, "versions": json.dumps(versions()), "controllers": json.dumps(manifest.controllers)}
    plan = planned(replace(campaign, earlier=manifest.earlier), manifest.controllers)
    return plan, Store(folder, columns(campaign, about), manifest.runs)


def _versions() -> dict[str, str]:
    """Returns the versions of the packages that decide the numbers."""
    return {name: version for name, version in versions().items() if name in NUMBERS}
