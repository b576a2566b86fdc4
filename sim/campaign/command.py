"""The command `sim.campaign`: runs a campaign or one of its parts, merges the results of all parts, or checks results."""

import argparse
import json
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from models.common.command import complain, print_json, versions
from models.common.errors import InputError, list_names
from models.common.files import made_folder, read_text
from models.common.printed import Stages, Whole, say
from models.common.threads import cores
from models.document.document import Document
from models.document.outputs import check_outputs, output_paths, written_lines
from models.document.picture import write_picture
from models.document.text import text_lines
from models.roads.opencrg import Surface
from models.roads.profile import Profile
from sim.campaign import MOST_RUNS, parts
from sim.campaign.best import choose, requested_best, save
from sim.campaign.columns import columns
from sim.campaign.controllers import check_code, design_controllers, plan_controllers
from sim.campaign.file import Campaign, parse_campaign, read_campaign
from sim.campaign.manifest import ELSEWHERE, FULL, NAME, PARTS, RESULTS, Manifest, gains_of, lock_folder, read_manifest
from sim.campaign.parts import CampaignPart
from sim.campaign.plan import RATE, Plan, Progress
from sim.campaign.store import Store
from sim.campaign.summary import compare, compared_lines, describe, summarise, trade_off
from sim.campaign.verify import verify
from sim.campaign.workers import Rows, cluster, run_batches
from sim.drive import RUNS_AT_ONCE
from sim.studies.ride.scores import scores_record

FINISHED_ADVICE = "give the folder with the results of a finished campaign"
MOST_OF_A_RUN = 0.99  # a remark is printed if a road from a file covers a smaller share of the run than this
NUMBERS = ("roadproof", "mujoco", "numpy", "scipy")  # packages whose versions affect a campaign's results


def run_campaign(options: argparse.Namespace) -> int:
    """Simulates those runs of a campaign that have no results yet, and prints the results of all runs; returns the exit code.

    Raises:
        InputError: the campaign file or the results folder is invalid, options cannot be combined, or the disk is full.
    """
    campaign = _read(options)
    request = requested_best(campaign, options.best, options.subject_to or (), options.save)
    read = [options.file, *(file for vehicle in campaign.vehicles.values() for file in vehicle.files)]
    check_outputs({"picture": options.picture, "save": options.save}, read, options.json)
    folder = _folder(options)
    stage = Stages("designs", "runs", "results")
    with _cluster(options), nullcontext() if options.merge else lock_folder(folder):
        stage("designs")
        if options.merge:
            _merge(campaign, folder)
        manifest = _begin_manifest(campaign, folder, options.file, options.exported)
        plan, store = _plan(campaign, manifest, folder)
        store.tidy()
        progress = _simulate(options, plan, store, stage)
        if options.merge:
            parts.remove(folder)
        stage("results")
        entries, scores = summarise(plan, store), compare(plan, store)
        choices = [choose(plan, store, request, vehicle) for vehicle in campaign.vehicles] if request is not None else []
        within = all(choice.within for choice in choices)
        figure = trade_off(plan, entries, scores) if options.picture is not None else None
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
            "compared": [{"vehicle": name, **scores_record([*some.values()])} for name, some in scores.items()],
            "best": [choice.record for choice in choices],
            "saved_controller": saved,
            **output_paths(outputs),
        }
        print_json(result)
        return 0 if within else 1
    now = f"{progress.done} of them simulated now, {RATE.text(progress.rate)}" if progress.done else "all simulated before"
    lines = [f"{plan.count} runs of {campaign.duration:g} s with a timestep of {campaign.timestep:g} s, {now}"]
    gains = [entry for some in manifest.controllers.values() for entry in some.items()]
    coded = {f"{name} in {one['code']['numbers']}" for name, one in gains if "code" in one}
    lines += [f"controllers that run as compiled code: {list_names(coded)}"] if coded else []
    lines += ["", "results", Whole(f"  {store.results}")]
    if not options.brief:
        lines += ["", *text_lines(describe(entries), "full" if options.verbose else "normal")]
        lines += [] if options.verbose else ["-v adds ride, travel and load on each road: rms, 95th percentile, prediction"]
    lines += written_lines(outputs)
    lines += compared_lines(campaign, scores, {choice.vehicle: choice.candidate for choice in choices})
    lines += ["", *text_lines(Document("", tuple(choice.statement for choice in choices)))] if choices else []
    lines += [f"saved as controller {saved}"] if saved is not None else []
    say(lines)
    return 0 if within else 1


def run_part(options: argparse.Namespace) -> int:
    """Simulates the runs of one part (`--part`) that have no results yet; returns the exit code.

    Prints the progress of the campaign.

    Raises:
        InputError: the campaign file or the results folder is invalid, the part shares runs with an existing part, or the disk
            is full.
    """
    part, campaign, folder = parts.part_of(options.part), _read(options), _folder(options)
    if (folder / NAME).exists():
        raise InputError(
            f"{folder} already contains the whole campaign, not a part; omit --part, or give a different folder with --results"
        )
    parts.check_overlap(folder, sorted([*parts.there(folder), part]))
    stage = Stages("designs", "runs")
    with _cluster(options), made_folder(folder, "results", "give another folder with --results"):
        stage("designs")
        begun = _begin_manifest(campaign, folder / PARTS, options.file, options.exported, shared=True)
        with made_folder(part.folder(folder), "results", FULL):
            parts.begin(folder, part, begun)
        parts.check(folder, part, begun, campaign.digest, _versions())
        plan, store = _plan(campaign, begun, folder, part)
        progress = _simulate(options, plan, store, stage)
        if store.finished:
            store.tidy()
        stage.end()
    left = parts.unfinished_parts(folder, part.of)
    if options.json:
        about = {"results": str(store.results), "part": part.number, "parts": part.of, "runs": store.runs, "new": progress.done}
        print_json({**about, "damaged": store.damaged, "unfinished": left})
        return 0
    now = f"{progress.done} of them simulated now, {RATE.text(progress.rate)}" if progress.done else "all simulated before"
    lines = [f"part {part.number} of {part.of} has {store.runs} of the {plan.count} runs, {now}"]
    lines += ["", "results", Whole(f"  {store.results}"), ""]
    when = "when all are finished, merge them" if left else "all parts are finished; merge them"
    lines += [f"{parts.parts_text(left, part.of)} {'is' if len(left) == 1 else 'are'} not finished"] if left else []
    say([*lines, f"{when}: repeat this command with --merge instead of --part {part}"])
    return 0


def _read(options: argparse.Namespace) -> Campaign:
    """Reads the campaign file, prints remarks about the roads in this file, and checks that the options can be combined."""
    campaign = read_campaign(options.file)
    first, fastest, lasts = next(iter(campaign.vehicles.values())), max(campaign.speeds), campaign.duration
    for road in campaign.roads:
        if road.profile is not None and (remark := road.profile.remark(max(campaign.speeds) * campaign.duration)):
            complain(f"remark: road {road.text!r}: {remark}")
        if (
            isinstance(road.road, Profile | Surface)
            and road.build(first, fastest, 0, fastest * lasts).duration < MOST_OF_A_RUN * lasts
        ):
            after = "the straight road after its last point lowers every rms value"
            complain(f"remark: road {road.text!r} is shorter than a run of {lasts:g} s at {fastest:g} m/s; {after}")
    if options.ray is not None and "workers" in options.given:
        raise InputError(
            "--workers sets the number of threads on this machine, but --ray uses the workers of a cluster; omit one of the two"
        )
    return campaign


def _folder(options: argparse.Namespace) -> Path:
    """Returns the folder for the results of the campaign."""
    return options.results or options.file.with_name(f"{options.file.stem}-results")


def _cluster(options: argparse.Namespace) -> AbstractContextManager[None]:
    """Returns a context manager that connects to the Ray cluster of `--ray`; without `--ray`, the context does nothing."""
    return cluster(options.ray) if options.ray is not None else nullcontext()


def _simulate(options: argparse.Namespace, plan: Plan, store: Store, stage: Stages) -> Progress:
    """Simulates the runs that have no row in the results folder yet, and joins the files of all batches into one."""
    for remark in store.damaged:
        print(f"roadproof: {remark}", file=sys.stderr)
    stage("runs")
    progress = Progress(plan, store.left, options.batch or RUNS_AT_ONCE, stage)

    def write(start: int, rows: Rows, took: float) -> None:
        store.write(start, rows)
        progress.add(len(rows), took)

    batches = plan.batches(store.missing(), progress.next_batch)
    try:
        run_batches(plan, batches, options.workers or cores(), options.ray is not None, write)
    except KeyboardInterrupt:
        stage.end()
        message = f"interrupted: {store.runs - store.left} of {store.runs} runs are kept; repeat the command to continue"
        raise KeyboardInterrupt(message) from None
    store.finish()
    return progress


def _merge(campaign: Campaign, folder: Path) -> None:
    """Joins the parts of a campaign to the files with its results and its plan, unless both files exist already.

    Raises:
        InputError: parts overlap, are missing or unfinished, or were simulated for a different campaign or with different
            versions of the packages.
    """
    # An earlier command has merged the parts, but was interrupted while it removed their folders
    if (folder / RESULTS).exists() and (folder / NAME).exists():
        return
    some = parts.there(folder)
    parts.check_complete(folder, some)
    begun, used = read_manifest(folder / PARTS, ELSEWHERE), _versions()
    if begun is None:
        raise InputError(f"{folder / PARTS} contains parts, but no record of their campaign; {ELSEWHERE}")
    begun.check(folder / PARTS, campaign.digest, used)
    for part in some:
        parts.check(folder, part, begun, campaign.digest, used)
    _, store = _plan(campaign, begun, folder)
    store.gather(_plan(campaign, begun, folder, part)[1] for part in some)
    begun.write(folder)


def check_results(options: argparse.Namespace) -> int:
    """Checks the results of a finished campaign and prints any errors that it finds; returns the exit code.

    Raises:
        InputError: the folder contains no finished campaign, or the campaign cannot be read on this machine.
    """
    folder = options.verify
    runs, verified, remark = _verify_runs(options, folder)
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


def _verify_runs(options: argparse.Namespace, folder: Path) -> tuple[int, dict[str, Any], str]:
    """Returns the number of runs, the errors that `verify` finds, and a remark if the campaign file has been changed or
    deleted.
    """
    manifest = read_manifest(folder, FINISHED_ADVICE) if folder.is_dir() else None
    if manifest is None:
        raise InputError(f"--verify {folder}: this folder contains no campaign; {FINISHED_ADVICE}")
    remark = ""
    if options.file is not None:
        campaign = read_campaign(options.file)
    else:
        file = Path(manifest.file)
        if not file.is_absolute() or not file.parent.is_dir():  # this is the case if the folder was copied from another machine
            file = folder.absolute().parent / file.name
        campaign = parse_campaign(manifest.campaign, file)
        now = "has changed" if file.is_file() else "no longer exists"
        if not file.is_file() or read_text(file, "campaign file", "") != manifest.campaign:
            remark = f"the campaign file {file} {now}; the copy in the folder of results is used"
    manifest.check(folder, campaign.digest, _versions(), FINISHED_ADVICE)
    if manifest.part:
        raise InputError(
            f"--verify {folder}: this folder contains only part {manifest.part} of a campaign; merge all parts with --merge first"
        )
    plan, store = _plan(campaign, manifest, folder)
    stage = Stages("rows", "repeated runs")
    stage("rows")
    progress = stage.counted("repeated runs", options.runs, "runs")
    verified = verify(plan, store, manifest.controllers, options.runs, options.seed, progress)
    stage.end()
    return plan.count, verified, remark


def _begin_manifest(campaign: Campaign, folder: Path, file: Path, exported: Path | None, shared: bool = False) -> Manifest:
    """Returns the manifest of the campaign. If the campaign has not begun yet, this function designs the gains and writes the
    manifest.

    Args:
        campaign: campaign to which the runs belong.
        folder: folder that contains the manifest, or to which it is written.
        file: path of the campaign file.
        exported: folder with exported code that runs instead of one of the controllers; None without such code.
        shared: True for the folder that all parts of the campaign share, to which several processes may write at the same time.
    """
    count = Plan(campaign, {}).count
    if count > MOST_RUNS:
        raise InputError(f"the campaign has {count} runs, but at most {MOST_RUNS} are allowed; give fewer seeds or samples")
    used, manifest = _versions(), read_manifest(folder) if folder.exists() else None
    if manifest is None:
        gains = gains_of(design_controllers(campaign, exported))
        manifest = Manifest(str(file.absolute()), campaign.digest, used, campaign.text, gains, count)
        manifest = manifest.publish(folder) if shared else manifest.write(folder)
    manifest.check(folder, campaign.digest, used)
    if exported is not None:
        check_code(manifest.controllers, exported)
    return manifest


def _plan(campaign: Campaign, manifest: Manifest, folder: Path, part: CampaignPart | None = None) -> tuple[Plan, Store]:
    """Returns the plan of the runs, with the gains from the manifest, and the store for the results of the campaign or of
    `part`.
    """
    about = {"campaign": campaign.text, "versions": json.dumps(versions()), "controllers": json.dumps(manifest.controllers)}
    plan = plan_controllers(replace(campaign, earlier=manifest.earlier), manifest.controllers)
    where, share = (folder, plan.share(1, 1)) if part is None else (part.folder(folder), plan.share(part.number, part.of))
    return plan, Store(where, columns(campaign, about), share)


def _versions() -> dict[str, str]:
    """Returns the versions of the packages that affect the results, by name."""
    return {name: version for name, version in versions().items() if name in NUMBERS}
