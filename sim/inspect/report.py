"""Output of `sim.inspect`: the printed document, the JSON object, and the CSV file of the signals."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from models.common.printed import Whole, wrap_text
from models.document.document import Document, Statement, notes
from models.document.field import Record
from sim.inspect.findings import HOLDS, Finding
from sim.inspect.proof import InspectedRun, Proof
from sim.inspect.replay import as_response, controller_states
from sim.recording.run_log import MUJOCO, SAMPLED
from sim.runs.record import RUN, controller_record
from sim.runs.report import checks_table, share_statements, verdict, verdicts
from sim.runs.signal_table import run_columns, write_columns

INSPECTION_RECORD = Record[InspectedRun](
    name="recorded_run.name",
    samples=lambda one: max((len(response.times) for response in one.recorded_run.responses.values()), default=0),
    findings="findings",
    controller=lambda one: controller_record(one.again.controller) if one.again else None,
    road=lambda one: json.loads(one.recorded_run.claims.get("road", "null")),
    again=lambda one: RUN(one.again) if one.again else None,
)
RECORD = Record[Proof](
    log=lambda proof: str(proof.log.path),
    proves="holds",
    command_line=lambda proof: proof.log.metadata.get("command_line"),
    vehicle=lambda proof: proof.log.metadata.get("vehicle"),
    vehicle_type=lambda proof: proof.vehicle.kind.name if proof.vehicle else None,
    timestep="log.timestep",
    versions="log.versions",
    findings="findings",
    runs=INSPECTION_RECORD.all("runs"),
)


def describe(proof: Proof, in_table: bool = False) -> Document:
    """Returns the printed document: the log, the findings about the log and its runs, and whether all claims in the log are
    proved.

    Args:
        proof: result of the check, with the log and all findings.
        in_table: True for one table that contains all runs, instead of a document about each run.
    """
    log, vehicle = proof.log, proof.vehicle
    about = [log.metadata.get("command_line", ""), f"vehicle type {vehicle.kind.name}" if vehicle else "vehicle type unknown"]
    versions = ", ".join(f"{name} {version}" for name, version in log.versions.items())
    more = [f"vehicle file {log.metadata.get('vehicle', 'without a name')}", f"versions {versions}"]
    goals = any(finding.part == "goals" for one in proof.runs for finding in one.findings)
    holds = f"the log still proves what it claims{'; the log makes no claim about goals' if goals else ''}"
    answer = holds if proof.holds else f"the log DOES NOT PROVE what it claims: {', '.join(proof.broken)}"
    first = (*notes(*filter(None, about)), *notes(*more, detail="full"), *_statements(proof.findings))
    last = Document("", (Statement(answer, "holds" if proof.holds else "fails"),))
    runs = [_describe_together(proof.runs)] if in_table else [_describe_run(one) for one in proof.runs]
    return Document(Whole(log.path), (*first, *runs, last))


def _describe_together(runs: Sequence[InspectedRun]) -> Document:
    """Returns the document about several runs: their verdicts, norms and checks, and all findings that do not hold."""
    again = [one.again for one in runs if one.again is not None]
    findings = [
        (one.recorded_run.name, statement)
        for one in runs
        for statement in _statements(one.findings)
        if statement.detail != "full"
    ]
    shared = (*verdicts(again), *share_statements(findings))
    tables = [replace(checks_table(again), detail="normal")] * bool(again)
    more = "shown only with --json: gains, signals and the text of every finding that holds"
    return Document("", (*shared, *tables, *notes(*(one.caption for one in tables), more)))


def _describe_run(one: InspectedRun) -> Document:
    """Returns the document about a logged run: its verdict, samples, road, control law and findings."""
    run, title, about = one.again, f"run {one.recorded_run.name}", []
    if run is not None:
        time, controller = run.prediction.time, run.controller
        title += f": {verdict(run).text}"
        about.append(f"{len(time)} samples to {time[-1]:g} s, step {1e3 * run.prediction.timestep:g} ms; {run.road.words}")
        about.append(f"{controller.name} measures {', '.join(controller.measured) or 'nothing'}: {controller.text}")
        if controller.preview is not None:
            about.append(f"{controller.name} also uses the road {controller.preview.seconds:g} s ahead")
    return Document(title, (*notes(*about, detail="full"), *_statements(one.findings)))


def _statements(findings: Sequence[Finding]) -> tuple[Statement, ...]:
    """Returns findings as statements: first a list of the parts of the log that hold, then the other findings.

    With `-v`, each finding that holds is printed, too.
    """
    held = [one for one in findings if one.verdict == HOLDS]
    others = [one for one in findings if one.verdict != HOLDS]
    return (
        *notes(*[f"proved: {', '.join(dict.fromkeys(one.part for one in held))}"] * bool(held)),
        *notes(*(f"{one.part}: {one.text}" for one in held), detail="full"),
        *(Statement(f"{one.part} {one.verdict}: {one.text}", "note" if one.proved else "fails") for one in others),
    )


def short_line(proof: Proof) -> list[str]:
    """Returns the printed lines about one of several logs: whether all its claims are proved, and which parts of the log are
    not.
    """
    if proof.holds:
        return [Whole(f"still proves    {proof.log.path}")]
    return [Whole(f"DOES NOT PROVE  {proof.log.path}"), *wrap_text(", ".join(proof.broken), "  ", 4)]


def write_signals(path: Path, proof: Proof) -> None:
    """Writes the signals of all runs of a log to a CSV file, in the format of `sim.bump --csv`.

    Raises:
        InputError: the vehicle type of the log is unknown, or the file cannot be written.
    """
    if proof.vehicle is None:
        raise InputError("--csv: the log contains no signals of a known vehicle type; omit --csv")
    columns, longest, timestep = [], 0, proof.log.timestep
    for one in proof.runs:
        states = controller_states(one.again.controller) if one.again else ()
        sources = {"mujoco": MUJOCO, "sampled": SAMPLED}.items()
        responses = {source: as_response(proof.vehicle, one.recorded_run, name, timestep, states) for source, name in sources}
        responses |= {"recomputed": one.again.prediction.sampled} if one.again else {}
        columns += run_columns(one.recorded_run.name, responses)
        longest = max(longest, *(len(response.time) for response in responses.values()))
    write_columns(path, np.arange(longest) * timestep, columns)
