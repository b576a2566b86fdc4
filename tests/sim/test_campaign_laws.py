"""Laws in Python in campaigns: driven like any controller, alone with their faults, and never from what came with results."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from models.common.errors import InputError
from models.kinds.kind import HERE
from models.laws import python_runtime as running
from sim.campaign.__main__ import main
from sim.campaign.batch import FAILED_LAW, run_batch
from sim.campaign.controllers import design_controllers
from sim.campaign.file import read_campaign
from sim.campaign.manifest import read_manifest
from sim.campaign.plan import Plan
from sim.studies.ride.metrics import metrics_of
from tests.support.commands import answer, prose
from tests.support.pages import hopper

FORCE = '10825.2 * sample["suspension_deflection"] - 2069.5 * sample["sprung_velocity"]'
MASS = 'mass = sample.parameters["sprung_mass"]'
PLAIN = f"def step(sample, state):\n    {MASS}\n{{}}    return {FORCE}, state\n"
VECTORISED = f"def step(sample, state):\n    {MASS}\n{{}}    return ({FORCE})[:, None], state\nstep.vectorised = True\n"
CAR = """
[controllers.linear]
measured = ["suspension_deflection", "sprung_velocity"]
gain = [[10825.2, -2069.5]]
[controllers.mine]
measured = ["suspension_deflection", "sprung_velocity"]
law = "mine.py:step"
[controllers.many]
measured = ["suspension_deflection", "sprung_velocity"]
law = "many.py:step"
"""
TEXT = """
vehicles = ["car.toml"]
controllers = ["linear", "mine", "many"]
roads = ["iso8608:class=B", "bump:height=0.02"]
speeds = [20.0]
seeds = 2
duration = 0.3
settle = 0.1
timestep = 2e-3
[samples]
count = 4
[samples.parameters]
sprung_mass = { uniform = [400.0, 600.0] }
"""
RUNS = 4 * (2 + 1)  # of each controller: samples, seeds of one road and the other
BUMP = TEXT.replace('"iso8608:class=B", ', "")
BUMPS = 4  # of each controller, over that road alone
TWO = BUMP.replace('"linear", "mine", "many"', '"mine"').replace("count = 4", "count = 2")  # runs, one of a heavy car


def campaign_of(folder: Path, mine: str = "", many: str = "", text: str = TEXT) -> Path:
    """A campaign file whose laws do this first; `mass` is the body's."""
    (folder / "mine.py").write_text(PLAIN.format(mine), encoding="utf-8")
    (folder / "many.py").write_text(VECTORISED.format(many), encoding="utf-8")
    (folder / "car.toml").write_text((HERE / "quarter_car.toml").read_text(encoding="utf-8") + CAR, encoding="utf-8")
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return folder / "campaign.toml"


def rows_of(file: Path, *arguments: str, results: str = "results") -> list[dict]:
    """Returns what a campaign comes to."""
    folder = file.parent / results
    workers = [] if "--workers" in arguments else ["--workers", "1"]  # each has a process for laws
    assert main([str(file), "--results", str(folder), *workers, *arguments]) == 0
    return pq.read_table(folder / "results.parquet").to_pylist()


def plan_of(file: Path) -> Plan:
    """The runs of a campaign."""
    campaign = read_campaign(file)
    return Plan(campaign, design_controllers(campaign))


@pytest.mark.attack
def test_a_gain_in_python_has_its_metrics_and_no_claims(tmp_path, capsys):
    """Written in Python, vectorised or not, a gain has the metrics of its linear law, and none of the columns that compare."""
    rows = rows_of(campaign_of(tmp_path))
    said = prose(capsys.readouterr().out)
    assert len(rows) == 3 * RUNS
    metrics = [metric.name for metric in metrics_of(read_campaign(tmp_path / "campaign.toml").vehicles["car.toml"])]
    for linear, *own in zip(*(rows[k * RUNS : (k + 1) * RUNS] for k in range(3)), strict=True):
        for row in own:
            assert row["reason"] is None
            # Sums are taken in another order: 1e-16 of the terms, which a stable loop does not pile up.
            assert [row[name] for name in metrics] == pytest.approx([linear[name] for name in metrics], rel=1e-9, abs=1e-12)
            compared = ("linear_error", "settled", "settled_signal", "expected_error")
            assert {row[name] for name in row if name in compared or name.startswith(("linear_", "expected_"))} == {None}
        assert linear["linear_error"] is not None
    for name in ("mine", "many"):
        assert f"{name} is a law in Python, {name}.py:step. Linear analysis does not apply" in said
    for entry in answer(capsys, main, str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "results"))["summary"]:
        own = entry["controller"] != "linear"
        assert own == ("failed" in entry) == (entry["ride"]["predicted"] is None)
        assert not own or (entry["failed"], entry["first_failure"]) == (0, None)


FAULTS = {
    "    if mass > 500: raise ValueError('too heavy')\n": "ValueError: too heavy, line 3) at 0 s",
    "    if mass > 500 and sample.time > 0.1: return float('nan'), None\n": "finite; return finite numbers) at 0.102 s",
    "    while mass > 500: pass\n": "step takes longer than 0.2 s at 0 s",
    "    if mass > 500 and sample.time > 0.1: __import__('os')._exit(3)\n": "step ends its process (exit code 3) at 0.102 s",
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> list[dict] | None:
    """The runs of a law without a fault."""
    return run_batch(plan_of(campaign_of(tmp_path_factory.mktemp("sound"), text=TWO)), 0, 2)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_of_one_run(tmp_path, monkeypatch, sound, fault):
    """A law that raises, gives what is no force or does not come back fails its own run, with a reason; others are untouched."""
    monkeypatch.setattr(running, "LONGEST", 0.2)
    plan = plan_of(campaign_of(tmp_path, fault, text=TWO))
    rows = run_batch(plan, 0, 2)
    assert rows is not None
    assert sound is not None
    assert sum(row["parameter_sprung_mass"] > 500 for row in rows) == 1
    for row, untouched in zip(rows, sound, strict=True):
        if row["parameter_sprung_mass"] > 500:
            assert row["reason"].startswith(f"{FAILED_LAW}controller 'mine', law mine.py:step: ")
            assert FAULTS[fault] in row["reason"]
            assert set(row) == {name for name in untouched if name in plan.inputs(0)} | {"run", "reason"}
        else:
            assert row == untouched


@pytest.mark.attack
def test_the_same_whatever_runs_it(tmp_path, capsys):
    """Laws may end their process, and one for many runs fails by the fault of a few; workers and batches change no bit of that.

    Also said, again of results that are there: how many failed, and the first of them.
    """
    file = campaign_of(
        tmp_path,
        "    if mass > 540 and sample.time > 0.1: __import__('os').kill(__import__('os').getpid(), 9)\n    print('noise')\n",
        "    if (mass > 540).any(): raise ValueError('too heavy')\n",
        BUMP.replace("count = 4", "count = 2"),  # of which one is heavy
    )
    first = rows_of(file, "--batch", "3", results="a")
    said = capsys.readouterr().out
    rows_of(file, "--workers", "2", "--json", results="b")
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert (tmp_path / "a" / "results.parquet").read_bytes() == (tmp_path / "b" / "results.parquet").read_bytes()
    rows_of(file, "--json", results="a")
    assert json.loads(capsys.readouterr().out)["summary"] == summary
    assert sum(row["reason"] is not None for row in first) == 2
    for row in first:
        assert (row["reason"] is not None) == (row["controller"] != "linear" and row["parameter_sprung_mass"] > 540)
    for entry in summary:
        if entry["controller"] != "linear":
            why = (
                "step ends its process (signal SIGKILL) at 0.102 s" if entry["controller"] == "mine" else "ValueError: too heavy"
            )
            assert why in entry["first_failure"]
            assert entry["broke_off"] == 0
            assert f"{entry['failed']} of {entry['runs']} runs failed. The first error: {entry['first_failure']}" in prose(said)


@pytest.mark.attack
def test_a_law_goes_on_as_it_was(tmp_path, capsys):
    """A results folder has checksums of laws and no code. `--verify` runs the laws, and a changed one is refused in one line."""
    file, results = campaign_of(tmp_path, text=BUMP), tmp_path / "results"
    rows_of(file)
    manifest = read_manifest(results)
    assert manifest is not None
    assert set(manifest.controllers["car.toml"]["mine"]) == {"measured", "law", "sha256"}
    assert not any(b"def step" in path.read_bytes() for path in results.iterdir())
    assert len(answer(capsys, main, "--verify", str(results), "--runs", "12")["again"]) == 3 * BUMPS

    (tmp_path / "mine.py").write_text(PLAIN.format("") + "#", encoding="utf-8")
    for arguments in ([str(file), "--results", str(results)], ["--verify", str(results)]):
        with pytest.raises(InputError, match=r"controller 'mine': mine.py:step has changed since the campaign began"):
            main(arguments)


@pytest.mark.attack
def test_a_custom_vehicle_type_is_verified(tmp_path):
    """A finished campaign of a custom vehicle type is verified from its folder alone."""
    hopper(tmp_path)
    file = tmp_path / "campaign.toml"
    text = TEXT.replace("car.toml", "hopper.toml").replace('"linear", "mine", "many"', '"passive"')
    file.write_text(text.partition("[samples]")[0], encoding="utf-8")
    assert main([str(file), "--results", str(tmp_path / "results")]) == 0
    assert main(["--verify", str(tmp_path / "results"), "--runs", "1"]) == 0
