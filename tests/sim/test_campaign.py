"""`python -m sim.campaign`: every run once, the same numbers whatever runs them, and nothing lost however it ends."""

import contextlib
import dataclasses
import errno
import functools
import io
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from threadpoolctl import threadpool_limits

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from sim.campaign import store as campaign_store
from sim.campaign.__main__ import main
from sim.campaign.file import read_campaign
from sim.campaign.manifest import lock_folder, read_manifest
from sim.runs.run import run_controllers
from sim.studies.ride.metrics import metrics_of
from sim.studies.ride.run_metrics import driven_roughness, measure_run, roughness
from synth.vehicle.designer import Designer
from tests.models.test_semi_active_dampers import BOTH
from tests.support.commands import prose, refused
from tests.support.curved import DIGRESSIVE, curved_text

ROOT = Path(__file__).parents[2]
SMALL = """
vehicles = ["quarter_car", "half_car"]
controllers = ["passive", "I"]
roads = ["iso8608:class=A", "iso8608:class=E", "pothole:depth=0.02"]
speeds = [15.0, 25.0]
seeds = [0, 5]
duration = 0.6
settle = 0.1
timestep = 2e-3

[samples]
count = 2
method = "sobol"
seed = 3

[samples.parameters]
sprung_mass = { uniform = [0.8, 1.2], relative = true }
"""
RUNS = 2 * 2 * 2 * 2 * (2 + 2 + 1)  # vehicles, controllers, speeds, samples, and seeds of every road
# Gains that are given need no design: this starts in the time of its imports.
QUICK = """
vehicles = ["quarter_car"]
controllers = ["passive", "I_printed"]
roads = ["iso8608:class=B", "bump:height=0.02"]
speeds = [10.0, 20.0]
seeds = 60
duration = 0.2
settle = 0.0
timestep = 2e-3
"""


def run(folder, text, *arguments, results="results"):
    """Runs a campaign in this process; returns its rows and the file's metadata."""
    file = folder / "campaign.toml"
    file.write_text(text)
    assert main([str(file), "--results", str(folder / results), *arguments]) == 0
    table = pq.read_table(folder / results / "results.parquet")
    return table.to_pylist(), table.schema.metadata


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """The folder of a small campaign, its rows and their metadata, and what it printed with `--json`."""
    folder = tmp_path_factory.mktemp("small")
    with contextlib.redirect_stdout(io.StringIO()) as out:
        found = run(folder, SMALL, "--workers", "1", "--json")
    return folder, found, out.getvalue()


@pytest.fixture(scope="module")
def small(begun):
    """The rows of that campaign, and their metadata."""
    return begun[1]


def test_every_combination_is_a_row(small):
    """Every vehicle, controller, road, speed, sample and seed is one row; a road without a seed runs once."""
    rows, _ = small
    assert [row["run"] for row in rows] == list(range(RUNS))
    inputs = [tuple(row[name] for name in ("vehicle", "controller", "road", "speed", "sample", "seed")) for row in rows]
    assert len(set(inputs)) == RUNS
    assert {row["seed"] for row in rows if row["road"].startswith("iso")} == {0, 5}
    assert {row["seed"] for row in rows if row["road"].startswith("pothole")} == {None}
    masses = {row["parameter_sprung_mass"] for row in rows if row["vehicle"] == "quarter_car"}
    assert len(masses) == 2
    assert all(0.8 * 504.5 <= mass <= 1.2 * 504.5 for mass in masses)
    # Vehicles, controllers and samples share the IRI of a road; every class and seed has its own.
    rough = {(row["road"], row["seed"], row["iri"]) for row in rows if row["speed"] == 25.0 and row["seed"] is not None}
    assert len(rough) == len({iri for *_, iri in rough} - {None}) == 2 * 2


def test_the_file_says_what_it_is(small):
    """The campaign file, the gains and every version are in the results' metadata; columns of another vehicle are null."""
    rows, metadata = small
    assert metadata[b"campaign"].decode() == SMALL
    assert json.loads(metadata[b"versions"])["mujoco"]
    assert json.loads(metadata[b"controllers"])["quarter_car"]["I"]["gain"][0][0] == pytest.approx(10825.2, abs=0.1)
    assert rows[0]["heave_acceleration_rms"] is None
    assert rows[-1]["sprung_acceleration_rms"] is None
    assert rows[-1]["heave_acceleration_rms"] > 0


def test_threads_of_blas_change_no_bit(tmp_path):
    """Sums of matrices that BLAS shares out among threads are rounded as by one: a row does not depend on the machine's cores."""
    rows = []
    for threads in (1, 2):
        with threadpool_limits(threads, user_api="blas"):
            rows.append(run(tmp_path, QUICK.replace("seeds = 60", "seeds = 1"), results=f"by {threads}")[0])
    assert rows[0] == rows[1]


def test_rows_are_those_runs(tmp_path):
    """A row has the road's IRI, and the metrics that the same run has by itself: in MuJoCo, and expected or linear ones.

    A random road is measured once its start is forgotten, a bump from the start. With curves, with semi-active dampers that get
    requests, or with a controller that is sampled and late, a run has no exact linear response, and its columns are empty.
    """
    damped, late = "quarter_car_semi_active", "[implementation]\nsample_period = 4e-3\ndelay = 1\n"
    (tmp_path / "curved.toml").write_text(curved_text(suspension_damping=DIGRESSIVE))
    (tmp_path / "late.toml").write_text(f"{read_vehicle('quarter_car').text}\n{late}")
    text = f"""
vehicles = ["half_car", "curved.toml", "{damped}", "late.toml"]
controllers = ["passive", "I"]
roads = ["bump:height=0.02", "iso8608:class=A"]
speeds = [16.0]
seeds = [3]
duration = 0.8
settle = 0.4
timestep = 4e-3
[samples]
count = 1
[samples.parameters]
sprung_mass = {{ uniform = [0.8, 1.2], relative = true }}
"""
    rows, _ = run(tmp_path, text, "--workers", "1")
    about = pq.read_schema(tmp_path / "results" / "results.parquet").field("iri").metadata
    assert about[b"unit"] == b"m/km"
    assert b"a property of the road" in about[b"definition"]
    campaign = read_campaign(tmp_path / "campaign.toml")
    for row in rows:
        nominal = campaign.vehicles[row["vehicle"]]
        vehicle = nominal.with_parameters(sprung_mass=row["parameter_sprung_mass"])
        (choice,) = (road for road in campaign.roads if road.text == row["road"])
        road = choice.build(vehicle, row["speed"], 3, row["speed"] * campaign.duration)
        (alone,) = run_controllers(vehicle, [Designer(nominal).design(row["controller"])], road, campaign.time)
        found, exact = measure_run(alone, campaign.first if choice.random else 0), row["vehicle"] == "half_car"
        exact |= row["vehicle"] != "curved.toml" and row["controller"] == "passive"
        assert row["iri"] == roughness(driven_roughness(vehicle, road, campaign.time))["iri"]["road"] > 1
        begun = (None, None) if found.settled is None else (pytest.approx(found.settled.share), found.settled.signal)
        assert (row["settled"], row["settled_signal"]) == begun
        assert row["expected_error"] == (None if found.error is None else pytest.approx(found.error, rel=1e-6))
        assert row["vehicle"] != "half_car" or choice.random == (found.settled is not None)
        for name, metric in found.metrics.items():
            assert row[name] == pytest.approx(metric.mujoco, rel=1e-9, abs=1e-12), name  # sums in another order
            linear = metric.sampled if exact and not choice.random else None
            for column, value in ((f"expected_{name}", metric.expected), (f"linear_{name}", linear)):
                assert row[column] == (None if value is None else pytest.approx(value, rel=1e-6, abs=1e-9)), column
        assert (row["linear_error"] is None) == (not exact)
        if exact and row["ended_by"] is None:
            states = [alone.agreement.signals[name].sampled for name in vehicle.linear_model.states]
            assert row["linear_error"] == pytest.approx(max(states), rel=0.2)  # scales of states only
        assert (row["ended_at"] is None) == (row["ended_by"] is None)


@pytest.mark.attack
def test_adjustable_dampers_are_sampled(tmp_path):
    """Numbers of `[actuators]` are sampled as parameters are, of all dampers that share one, or of one by its suspension.

    A row of a sample is the run of the vehicle file that has its numbers.
    """
    (tmp_path / "car.toml").write_text(BOTH + '[controllers.law]\nsemi_active = "skyhook"\n')
    text = 'vehicles = ["car.toml"]\ncontrollers = ["law"]\nroads = ["bump"]\nspeeds = [12.5]\nduration = 0.8\n'
    text += "[samples]\ncount = 3\n"
    of = "c_max_front = { uniform = [0.6, 1.2], relative = true }\nbandwidth_rear = { uniform = [40.0, 200.0] }\n"
    rows, _ = run(tmp_path, f"{text}[samples.parameters]\n{of}", "--workers", "1")
    for row in rows:
        c_max, bandwidth = row["parameter_c_max_front"], row["parameter_bandwidth_rear"]
        assert 1800 <= c_max <= 3600
        (tmp_path / "car.toml").write_text(
            (BOTH + '[controllers.law]\nsemi_active = "skyhook"\n')
            .replace("c_max = 3000.0", f"c_max = {c_max!r}")
            .replace("bandwidth = 90.0", f"bandwidth = {bandwidth!r}")
        )
        (alone,), _ = run(tmp_path, text.partition("[samples]")[0], "--workers", "1", results=f"alone{row['run']}")
        for name, value in alone.items():
            if name != "sample" and name != "run":
                assert row[name] == (value if isinstance(value, (str, type(None))) else pytest.approx(value, rel=1e-9)), name
    assert len({row["suspension_deflection_front_rms"] for row in rows}) == 3


@pytest.mark.attack
def test_samples_in_another_unit_are_remarked(tmp_path, capsys, monkeypatch):
    """Factors without `relative = true` make a car of a kilogram, which the plausibility remark of a vehicle file finds, too."""
    monkeypatch.setattr("models.common.command._remarks", [])  # as at the start of a command
    text = SMALL.replace(", relative = true", "").replace(', "half_car"', "")  # which is refused
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    read_campaign(tmp_path / "campaign.toml")
    assert "the body's natural frequency is about 20 Hz; check that sprung_mass is in kg" in prose(capsys.readouterr().err)


def test_a_short_road_has_no_iri(tmp_path):
    """For a way shorter than 11 m there is no IRI; of a car's two tracks there are four, which are of no vehicle with one."""
    text = (
        'vehicles = ["full_car", "quarter_car"]\ncontrollers = ["passive"]\nroads = ["iso8608:class=C"]\nspeeds = [10.0, 30.0]\n'
    )
    rows, _ = run(tmp_path, f"{text}duration = 0.5\n", "--workers", "1")
    short, long = rows[0], rows[1]
    names = ["iri_left", "iri_right", "iri_mean", "iri_half_car"]
    assert [short[name] for name in names] == [None] * 4
    assert long["iri_mean"] == (long["iri_left"] + long["iri_right"]) / 2
    assert long["iri_half_car"] < long["iri_mean"]  # twist is missing in it
    assert long["iri"] is None
    assert [rows[2]["iri"], rows[3]["iri"]] == [None, long["iri_left"]]


def test_where_it_is_linear_it_agrees(small):
    """Runs that stay linear are their linear twins to RK4's error and geometry's; of others, wheels lift, and it says when."""
    rows, _ = small
    linear = [row for row in rows if row["ended_by"] is None]
    assert max(row["linear_error"] for row in linear if row["vehicle"] == "quarter_car") < 1e-4  # RK4 at 2 ms
    assert max(row["linear_error"] for row in linear) < 1e-2  # a body that pitches
    lifted = [row for row in rows if row["ended_by"] == "lift-off"]
    assert len(lifted) > 5
    assert all(row["road"] != "iso8608:class=A" and 0 <= row["ended_at"] <= 0.6 for row in lifted)


def root_mean_square(values):
    return np.sqrt(np.mean(np.square(list(values))))


def test_summary(begun, small, capsys):
    """The table at the end is root mean square and percentile of the rows of the worst point, beside what is predicted of it.

    Without -v it says of each controller how many runs left the linear regime.
    """
    folder, _, printed = begun
    result = json.loads(printed, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert result["runs"] == result["new"] == RUNS
    assert len(result["summary"]) == 2 * 3 * 2 * 2
    for entry in result["summary"]:
        some = [row for row in small[0] if all(row[name] == entry[name] for name in ("vehicle", "controller", "road", "speed"))]
        assert entry["runs"] == len(some)
        assert entry["left"] == sum(row["ended_by"] is not None for row in some)
        columns = ["dynamic_load"] if entry["vehicle"] == "quarter_car" else ["dynamic_load_front", "dynamic_load_rear"]
        rms = {name: root_mean_square(row[name] for row in some) for name in columns}
        assert entry["load"]["column"] == max(rms, key=lambda name: rms[name])
        assert entry["load"]["rms"] == pytest.approx(max(rms.values()))
        assert entry["load"]["p95"] == pytest.approx(np.percentile([row[entry["load"]["column"]] for row in some], 95))
        prefix = "expected" if entry["road"].startswith("iso") else "linear"
        predicted = root_mean_square(row[f"{prefix}_{entry['load']['column']}"] for row in some)
        assert entry["load"]["predicted"] == pytest.approx(predicted)
    main([str(folder / "campaign.toml"), "--results", str(folder / "results")])
    short = capsys.readouterr().out
    for car in ("quarter_car", "half_car"):
        of = {name: [row for row in small[0] if (row["vehicle"], row["controller"]) == (car, name)] for name in ("passive", "I")}
        left = {name: sum(row["ended_by"] is not None for row in some) for name, some in of.items()}
        order = sorted(of, key=lambda name: left[name] / len(of[name]))
        told = ", ".join(f"{left[name]} of {len(of[name])} with {name}" for name in order if left[name])
        assert f"{car}: Runs that left the linear regime: {told or 'none'}." in prose(short)


def test_who_is_best_over_all_runs(begun, small):
    """The last table has every controller over all runs: mean squares of ride, load and force, mean shares, the largest peak."""
    printed = begun[2]
    for entry in json.loads(printed)["compared"]:
        ends = ("",) if entry["vehicle"] == "quarter_car" else ("_front", "_rear")
        for one in entry["controllers"]:
            some = [row for row in small[0] if (row["vehicle"], row["controller"]) == (entry["vehicle"], one["controller"])]
            peaks = [row[f"suspension_deflection{end}_peak"] for row in some for end in ends]
            assert one["peak_travel"] == max(peaks)
            assert one["dynamic_load"] == pytest.approx(
                max(root_mean_square(row[f"dynamic_load{end}"] for row in some) for end in ends)
            )
            assert one["off_ground"] == pytest.approx(max(np.mean([row[f"off_ground{end}"] for row in some]) for end in ends))
        assert not any(entry["best"].values())  # `I` has a disk margin below 0.3, and there is no other controller than passive


def test_columns_say_what_they_are(begun):
    """Every metric has its unit and definition in the Parquet file, and an expectation that is approximate says so."""
    schema = pq.read_schema(begun[0] / "results" / "results.parquet")
    for metric in metrics_of(read_vehicle("quarter_car")):
        for prefix in ("", "expected_", "linear_"):
            about = schema.field(f"{prefix}{metric.name}").metadata
            assert about[b"unit"].decode() == metric.unit
            rough = prefix == "expected_" and metric.name.endswith(("_vdv", "_mtvv", "_crest", "_peak"))
            assert (b"approximate" in about) == rough
    definitions = [schema.field(f"{prefix}dynamic_load").metadata[b"definition"] for prefix in ("", "expected_", "linear_")]
    assert len(set(definitions)) == 3


def test_a_flat_tyre_is_a_row(tmp_path, capsys):
    """A run on a flat tyre has its reason and when, neither metrics nor a linear response, and counts in no mean.

    A road of 1 m is through the hub within a step; one of 0.3 m leaves it above, and the tyre squeezed.
    """
    text = 'vehicles = ["quarter_car"]\ncontrollers = ["I_printed"]\n'
    text += 'roads = ["step:height=1", "step:height=0.3", "bump:height=0.02"]\n'
    (through_hub, flat, through), _ = run(tmp_path, text + "speeds = [20.0]\nduration = 0.6\n", "--json")
    assert through["reason"] is None
    for row in (through_hub, flat):
        assert row["reason"] == f"flat: a tyre is compressed by more than 0.25 m at {row['ended_at']:.4g} s"
        assert (row["ended_by"], row["diverged_at"]) == ("flat tyre", None)
    for name in (metric.name for metric in metrics_of(read_vehicle("quarter_car"))):
        assert flat[name] is None
        assert flat[f"linear_{name}"] is None
        assert through[f"linear_{name}"] == pytest.approx(through[name], rel=1e-2, abs=1e-9)
    broken, _, whole = json.loads(capsys.readouterr().out)["summary"]
    assert (broken["broke_off"], whole["broke_off"]) == (1, 0)
    assert broken["ride"] == {"column": None, "rms": None, "standard_error": None, "p95": None, "predicted": None}


def test_a_diverging_run_is_a_row(tmp_path):
    """A run that diverges has its reason and when, no metrics, and leaves those beside it as they are."""
    unstable = read_vehicle("quarter_car").text + '\n[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[1e6]]\n'
    (tmp_path / "wild.toml").write_text(unstable)
    text = 'vehicles = ["wild.toml"]\ncontrollers = ["wild", "passive"]\nroads = ["bump"]\nspeeds = [20.0]\nduration = 0.4\n'
    (wild, passive), _ = run(tmp_path, text)
    assert wild["reason"] == f"diverged: a signal is beyond 1e+08 at {wild['diverged_at']:.4g} s"
    assert wild["sprung_acceleration_rms"] is None
    (alone,), _ = run(tmp_path, text.replace('"wild", ', ""), results="alone")
    assert {**alone, "run": 1} == passive
    assert passive["reason"] is None


def command(folder, *arguments):
    """The command as a user starts it."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    asked = ["campaign.toml", "--results", "results", "--batch", "8", "--json", *arguments]
    process = functools.partial(subprocess.Popen, cwd=folder, env=environment, text=True)
    return process([sys.executable, "-m", "sim.campaign", *asked], stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def killed(folder, chance, signal_number, there=".lock"):
    """Starts the campaign, ends it by a signal at a random moment after its folder has such a file; its exit code and output."""
    process = command(folder)
    while process.poll() is None and not any((folder / "results").glob(there)):
        time.sleep(0.005)
    time.sleep(chance)
    process.send_signal(signal_number)
    out, err = process.communicate()
    return process.returncode, out, err


@pytest.mark.attack
def test_killed_ten_times(tmp_path):
    """Killed at ten random moments and started again each time, it ends with the rows of an uninterrupted run, each once."""
    (tmp_path / "campaign.toml").write_text(QUICK)
    rng, lives = random.Random(20261121), []
    while len(lives) < 10:
        code, _, _ = killed(tmp_path, rng.uniform(0, 0.9), signal.SIGKILL)
        names = [path.name for path in (tmp_path / "results").glob("[!.]*.parquet")]  # others are being written
        lives.append((code, len(names)))
        for name in names:  # what has a name is whole
            pq.read_metadata(tmp_path / "results" / name)
    assert sum(code == -signal.SIGKILL for code, _ in lives) > 0  # later ones come when all is done
    process = command(tmp_path)
    out, err = process.communicate()
    assert (process.returncode, err) == (0, "")
    assert json.loads(out)["runs"] == 2 * 2 * 61
    assert sorted(path.name for path in (tmp_path / "results").iterdir()) == [".lock", "plan.json", "results.parquet"]
    rows, _ = run(tmp_path, QUICK, results="uninterrupted")
    assert pq.read_table(tmp_path / "results" / "results.parquet").to_pylist() == rows


@pytest.mark.attack
def test_interrupted(tmp_path):
    """Ctrl-C ends it with 130 and says what is kept; the next start goes on."""
    (tmp_path / "campaign.toml").write_text(QUICK.replace("seeds = 60", "seeds = 20000"))
    code, out, err = killed(tmp_path, 0.0, signal.SIGINT, "part-*")
    assert (code, out) == (130, "")
    assert re.fullmatch(r"roadproof: interrupted: \d+ of 80004 runs are kept; repeat the command to continue\n", err)
    assert not list((tmp_path / "results").glob(".*part*"))


def test_a_full_disk(tmp_path, monkeypatch):
    """A disk that fills up is one line, exit code 2; what is done is kept, nothing half-written, and later it goes on."""
    file = tmp_path / "campaign.toml"
    file.write_text(QUICK.replace("seeds = 60", "seeds = 3"))
    real, writes = campaign_store.whole_file, []

    @contextlib.contextmanager
    def fills(path, what, instead):
        with real(path, what, instead) as beside:
            yield beside
            writes.append(path)
            if len(writes) == 2:
                raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(campaign_store, "whole_file", fills)
        with pytest.raises(InputError, match=r"No space left on device.*free some space"):
            main([str(file), "--results", str(tmp_path / "results"), "--batch", "2"])
    assert len(list((tmp_path / "results").glob("part-*"))) == 1
    assert not list((tmp_path / "results").glob(".*part*"))
    rows, _ = run(tmp_path, file.read_text())
    fresh, _ = run(tmp_path, file.read_text(), results="fresh")
    assert rows == fresh


def test_another_campaign_is_left_alone(tmp_path):
    """A results folder that holds another campaign, other versions, other files or a running one is refused and not touched."""
    text = QUICK.replace("seeds = 60", "seeds = 1")
    rows, _ = run(tmp_path, text)
    with pytest.raises(InputError, match="contains the results of another campaign"):
        run(tmp_path, text.replace("10.0", "11.0"))
    manifest = read_manifest(tmp_path / "results")
    assert manifest is not None
    dataclasses.replace(manifest, versions={**manifest.versions, "mujoco": "1.0"}).write(tmp_path / "results")
    with pytest.raises(InputError, match=r"started with mujoco 1\.0"):
        run(tmp_path, text)
    manifest.write(tmp_path / "results")
    with lock_folder(tmp_path / "results"), pytest.raises(InputError, match="another campaign is running"):
        run(tmp_path, text)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").touch()
    with pytest.raises(InputError, match=r"contains no campaign, but other files such as cat\.png"):
        run(tmp_path, text, results="photos")
    with pytest.raises(
        InputError, match=r"contains no campaign, but other files such as cat\.png; give the folder with the resul"
    ):
        main(["--verify", str(tmp_path / "photos")])
    assert run(tmp_path, text)[0] == rows


BASE = {"vehicles": '["quarter_car"]', "controllers": '["I"]', "roads": '["iso8608:class=C"]', "speeds": "[20.0]"}
SAMPLED = "[samples]\ncount = 4\n[samples.parameters]\n"
DAMPED = {"vehicles": '["both.toml"]', "controllers": '["passive"]'}

# (changes to the keys of a file that is fine, text after them, what is said)
BAD_FILES = [
    ({"vehicles": '["no_car"]'}, "", "vehicle file no_car"),
    ({"controllers": '["III"]'}, "", "has no controller 'III'; it has I, II"),
    ({"speeds": "[10, 10.0]"}, "", "speeds: 10 and 10.0 are the same; list only one of them"),
    ({"vehicles": f'["quarter_car", "{(ROOT / "models" / "quarter_car.toml").as_posix()}"]'}, "", "are the same; list only one"),
    ({"roads": '["bump", "bump:height=0.1"]'}, "", "roads: 'bump' and 'bump:height=0.1' are the same; list only one of them"),
    ({"roads": '["bump:length=0.01"]'}, "", "less than two timesteps"),
    ({"seeds": "[1, 2.5]"}, "", "seeds[1] = 2.5 is not allowed; give an integer"),
    ({"seeds": "[1, 1]"}, "", "seeds: 1 and 1 are the same; list only one of them"),
    ({"seeds": "20000000"}, "", "or a list of seeds"),
    ({"settle": "8.0"}, "", "settle = 8 s is too long for runs of 10 s"),
    ({"timestep": "0.1"}, "", "RK4 is unstable"),
    ({}, "[samples]\ncount = 4\n", "names no quantity to sample"),
    ({}, SAMPLED + "colour = { uniform = [1, 2] }", "'colour' cannot be sampled; sample one of sprung_mass"),
    ({}, SAMPLED + "sprung_mass = 3", "sprung_mass = 3 is not a distribution"),
    ({}, SAMPLED + "sprung_mass = { cauchy = [1, 2] }", "is not a distribution; give sprung_mass = { uniform = [low, high] } or"),
    ({}, SAMPLED + "sprung_mass = { uniform = [500, 400] }", "is an empty range"),
    ({}, SAMPLED + "sprung_mass = { normal = [500, 0] }", "has no positive deviation; give a standard deviation above 0"),
    (
        {},
        SAMPLED + "sprung_mass = { uniform = [-10, 400] }",
        "vehicle 'quarter_car': the distribution of sprung_mass contains a value that is not allowed: sprung_mass = -10",
    ),
    ({}, SAMPLED + "sprung_mass = { uniform = ['400 kg', '500 kg'], relative = true }", "but a pure number is expected"),
    (
        {},
        SAMPLED + "tyre_stiffness = { uniform = [1e3, 2e5] }",
        "vehicle 'quarter_car': sampled values do not fit together: tyre_deflection at rest",
    ),
    # A key that dampers do not share, or cannot be
    (DAMPED, SAMPLED + "c_max = { uniform = [0.5, 1.0], relative = true }", "c_max_front, c_max_rear"),
    (DAMPED, SAMPLED + "c_max_front = { uniform = [0.1, 0.2], relative = true }", "front = 1000 N s/m, which applies while"),
]


@pytest.mark.parametrize(("changes", "after", "said"), BAD_FILES, ids=[row[2][:40] for row in BAD_FILES])
def test_bad_files(tmp_path, monkeypatch, capsys, changes, after, said):
    """A file that makes no campaign is refused in one line that names it, and no results folder is made."""
    monkeypatch.chdir(tmp_path)
    entries = {**BASE, **changes}
    Path("both.toml").write_text(BOTH)
    lines = [f"{key} = {value}" for key, value in entries.items() if value is not None]
    Path("campaign.toml").write_text("\n".join([*lines, after]))
    with refused(said, match="^campaign file campaign.toml: "):
        main(["campaign.toml"])
    assert capsys.readouterr().out == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["both.toml", "campaign.toml"]


@pytest.mark.parametrize(
    ("address", "words"),
    [("nowhere.invalid:1", "does not answer"), ("127.0.0.1:1", "does not answer"), ("head", "this is not an address")],
)
def test_a_cluster_that_is_not_there_is_said_at_once(tmp_path, address, words):
    """One line, before anything is written, and nothing is waited for."""
    pytest.importorskip("ray")
    (tmp_path / "campaign.toml").write_text(
        'vehicles = ["quarter_car"]\ncontrollers = ["passive"]\nroads = ["bump"]\nspeeds = [9.0]\n'
    )
    with refused(words):
        main([str(tmp_path / "campaign.toml"), "--ray", address])
    assert [path.name for path in tmp_path.iterdir()] == ["campaign.toml"]
