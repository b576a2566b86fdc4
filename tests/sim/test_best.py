"""`sim.campaign --best`: laws drawn by their keys, the best of them within limits, and the vehicle file that has it."""

import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.stats import qmc

from models.vehicle.vehicle import read_vehicle
from sim.campaign.__main__ import main
from sim.campaign.file import read_campaign
from sim.campaign.plan import Plan
from sim.campaign.summary import trade_off
from tests.support.commands import answer, attacks, prose, refused

CAR = (
    read_vehicle("quarter_car_semi_active").text
    + '\n[controllers.written]\nmeasured = ["sprung_velocity"]\nlaw = "law.py:step"\n'
)
STATES = (
    read_vehicle("quarter_car").text
    + """
[limits]
actuator_force = 300.0
[controllers.states]
measured = ["suspension_deflection", "sprung_velocity"]
A = [[-3.0]]
B = [[0.0, 300.0]]
C = [[-5.0]]
D = [[8000.0, 0.0]]
anti_windup = 20.0
"""
)
FILE = """
vehicles = ["car.toml"]
controllers = ["passive", "skyhook", "hybrid", "sky"]
roads = ["iso8608:class=C", "bump:height=0.03"]
speeds = [15.0]
seeds = 2
duration = 0.5
timestep = 2e-3

[samples]
count = 2
variants = 5
seed = 4
[samples.parameters]
sprung_mass = { uniform = [0.9, 1.1], relative = true }
[samples.controllers.hybrid]
sky_damping = { uniform = [0.0, 4000.0] }
mix = { normal = [0.5, 0.1] }
[samples.controllers.sky]
"gain[0][0]" = { uniform = [0.0, 2.0], relative = true }
"""
DRAWN = ("law_sky_damping", "law_mix", "law_gain[0][0]")
RIDE, TRAVEL, LOAD = "sprung_acceleration_weighted", "suspension_deflection_peak", "dynamic_load"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """The folder of a finished campaign, and its rows."""
    folder = tmp_path_factory.mktemp("best")
    (folder / "car.toml").write_text(CAR)
    (folder / "campaign.toml").write_text(FILE)
    assert main([str(folder / "campaign.toml"), "--workers", "1", "--brief"]) == 0
    return folder, pq.read_table(folder / "campaign-results" / "results.parquet").to_pylist()


def chosen(folder, capsys, *options) -> tuple[int, dict]:
    """The exit code and the choice of a finished campaign."""
    capsys.readouterr()
    code = main([str(folder / "campaign.toml"), "--json", *options])
    (found,) = json.loads(capsys.readouterr().out)["best"]
    return code, found


def candidates(rows) -> dict[tuple[str, int | None], list[dict]]:
    """The rows of every controller and variant."""
    found: dict[tuple[str, int | None], list[dict]] = {}
    for row in rows:
        found.setdefault((row["controller"], row["variant"]), []).append(row)
    return found


def over_runs(rows, metric) -> float:
    """A metric over all runs, from their rows."""
    values = np.array([row[metric] for row in rows])
    return float(values.max() if metric.endswith("_peak") else np.sqrt(np.mean(values**2)))


def test_every_variant_meets_the_same_roads_and_vehicles(campaign):
    """Variants of a law are driven over the same roads, in the same vehicles; columns have their keys, null for other laws."""
    _, rows = campaign
    by_law = candidates(rows)
    assert [sum(name == law for law, _ in by_law) for name in ("passive", "skyhook", "hybrid", "sky")] == [1, 1, 5, 5]
    met = {
        tuple((row["road"], row["seed"], row["sample"], row["parameter_sprung_mass"], row["iri"]) for row in some)
        for some in by_law.values()
    }
    assert len(met) == 1
    assert len(next(iter(met))) == 2 * (2 + 1)
    for (controller, _), some in by_law.items():
        keys = {tuple(row[key] for key in DRAWN) for row in some}
        assert len(keys) == 1
        there = {key for key in DRAWN if some[0][key] is not None}
        assert there == {"hybrid": {*DRAWN[:2]}, "sky": {DRAWN[2]}}.get(controller, set())
    drawn = [some[0] for (law, _), some in by_law.items() if law == "hybrid"]
    unit = qmc.LatinHypercube(2, rng=np.random.default_rng(4)).random(5)
    assert [row["law_sky_damping"] for row in drawn] == (4000.0 * unit[:, 0]).tolist()
    assert len({row["law_mix"] for row in drawn}) == 5
    assert all(-8000 <= some[0]["law_gain[0][0]"] <= 0 for (law, _), some in by_law.items() if law == "sky")
    assert len({row[RIDE] for row in rows}) == len(rows), "other keys, other runs"


@pytest.mark.parametrize(
    ("best", "metric", "limits"),
    [
        ("ride", RIDE, {}),
        ("ride", RIDE, {"peak_travel": (TRAVEL, 0.5)}),
        (LOAD, LOAD, {"ride": (RIDE, 0.7)}),
        (TRAVEL, TRAVEL, {"ride": (RIDE, 0.9), LOAD: (LOAD, 0.7)}),
    ],
)
def test_the_best_is_the_best_of_the_table(campaign, capsys, best, metric, limits):
    """By the rows alone nothing within the limits is better; a candidate exactly at a limit is within."""
    folder, rows = campaign
    numbers = {who: {name: over_runs(some, name) for name in (RIDE, TRAVEL, LOAD)} for who, some in candidates(rows).items()}
    at = {
        key: float(np.quantile([one[name] for one in numbers.values()], share, method="lower"))
        for key, (name, share) in limits.items()
    }
    within = {who: one for who, one in numbers.items() if all(one[limits[key][0]] <= limit for key, limit in at.items())}
    code, found = chosen(folder, capsys, "--best", best, *(f"--subject-to={key}:{limit!r}" for key, limit in at.items()))
    assert code == 0
    assert (found["within"], found["of"]) == (len(within), len(numbers))
    assert (len(within) < len(numbers)) == bool(limits)
    who = min(within, key=lambda one: within[one][metric])
    assert (found["best"]["controller"], found["best"]["variant"]) == who
    assert found["best"]["numbers"][best] == numbers[who][metric]
    assert all(found["best"]["numbers"][key] <= limit for key, limit in at.items())
    row = candidates(rows)[who][0]
    assert found["best"]["values"] == {key.removeprefix("law_"): row[key] for key in DRAWN if row[key] is not None}


@pytest.mark.parametrize(
    ("car", "law", "keys"),
    [
        *attacks([(CAR, "hybrid", "sky_damping = { uniform = [0.0, 4000.0] }\nmix = { uniform = [0.2, 0.8] }")]),
        (STATES, "states", '"A[0][0]" = { uniform = [-6.0, -2.0] }\nanti_windup = { uniform = [1.0, 400.0] }'),
    ],
    ids=["semi-active", "with states"],
)
def test_the_saved_file_drives_as_the_variant(tmp_path, capsys, car, law, keys):
    """The vehicle file that is written has the chosen law: its rows are the variant's, bit for bit; and it says its origin.

    So neither physics nor what is predicted depends on which variants are driven in the same batch.
    """
    (tmp_path / "car.toml").write_text(car)
    text = FILE.partition("[samples.controllers")[0].replace('"skyhook", "hybrid", "sky"', f'"{law}"').replace("= 5", "= 3")
    (tmp_path / "campaign.toml").write_text(f"{text}[samples.controllers.{law}]\n{keys}\n")
    options = ["--best", "ride", "--subject-to", "control_force_rms:1e4", "--subject-to", "ride:1e3"]
    options += ["--save", str(tmp_path / "tuned.toml"), "--batch", "7", "--workers", "1"]
    assert main([str(tmp_path / "campaign.toml"), *options]) == 0
    tuned = f"{law}_tuned"
    assert f"saved as controller {tuned}" in capsys.readouterr().out
    said = (tmp_path / "tuned.toml").read_text()
    (variant,) = re.findall(
        rf"variant (\d) of {law}: the best ride within control_force_rms <= 10000 N and ride <= 1000 m/s2", said
    )
    assert "seed 4 of [samples]" in said
    assert "--subject-to control_force_rms:1e4 --subject-to ride:1e3 --save" in said
    again = text.replace(f'"{law}"', f'"{tuned}"').replace("variants = 3\n", "").replace("car.toml", "tuned.toml")
    (tmp_path / "again.toml").write_text(again)
    assert main([str(tmp_path / "again.toml"), "--workers", "1"]) == 0
    then, driven = (pq.read_table(tmp_path / f"{one}-results" / "results.parquet").to_pylist() for one in ("campaign", "again"))
    same = [name for name in driven[0] if name not in ("run", "vehicle", "controller")]
    now = [[row[name] for name in same] for row in driven if row["controller"] == tuned]
    assert now == [[row[name] for name in same] for row in candidates(then)[law, int(variant)]]


def test_where_nothing_is_within_the_nearest_is_named(campaign, capsys):
    """One line says who is nearest and by how much it misses; nothing is saved, and the exit code is 1."""
    folder, rows = campaign
    numbers = {who: (over_runs(some, TRAVEL), over_runs(some, LOAD)) for who, some in candidates(rows).items()}
    travel, load = (min(one[i] for one in numbers.values()) / 2 for i in (0, 1))
    options = ["--best", "ride", "--subject-to", f"peak_travel:{travel!r}", "--subject-to", f"dynamic_load:{load!r}"]
    code, found = chosen(folder, capsys, *options)
    who = min(numbers, key=lambda one: max(numbers[one][0] / travel, numbers[one][1] / load))
    assert (code, found["best"], found["within"]) == (1, None, 0)
    nearest = found["nearest"]
    assert (nearest["controller"], nearest["variant"]) == who
    assert nearest["misses"] == {"peak_travel": numbers[who][0] - travel, "dynamic_load": numbers[who][1] - load}
    assert main([str(folder / "campaign.toml"), *options, "--brief", "--save", str(folder / "none.toml")]) == 1
    name = who[0] if who[1] is None else f"{who[0]}#{who[1]}"
    limits = r"peak_travel <= \S+ m and dynamic_load <= \S+"
    said = rf"None of the 12 candidates satisfies {limits}. .*{name}.* comes closest, but exceeds peak_travel by \S+ m \(.* %\)"
    assert re.search(said, prose(capsys.readouterr().out))
    assert not (folder / "none.toml").exists()


def test_where_every_run_breaks_off_nothing_is_best(tmp_path, capsys):
    """A law whose variants all break off has no numbers to compare, nothing is best, and the exit code is 1."""
    wild = '[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[1e6]]\n'
    (tmp_path / "car.toml").write_text(f"{read_vehicle('quarter_car').text}\n{wild}")
    text = FILE.partition("[samples]")[0].replace('"passive", "skyhook", "hybrid", "sky"', '"wild"')
    drawn = '[samples]\ncount = 2\n[samples.controllers.wild]\n"gain[0][0]" = { uniform = [1e6, 2e6] }\n'
    (tmp_path / "campaign.toml").write_text(text + drawn)
    options = ["--workers", "1", "--brief", "--best", "ride", "--save", str(tmp_path / "tuned.toml")]
    options += ["--picture", str(tmp_path / "tuned.png")]
    assert main([str(tmp_path / "campaign.toml"), *options]) == 1
    out, complaint = capsys.readouterr()
    assert "no picture is drawn, because no run of the campaign has both ride and tyre load" in prose(complaint)
    assert not (tmp_path / "tuned.png").exists()
    assert "No controller can be compared, because each has a run that ended early." in out
    assert "each of the 2 candidates has runs that ended early, so no candidate has a ride." in prose(out)
    assert not (tmp_path / "tuned.toml").exists()


def test_a_chosen_controller_that_is_not_drawn_stands_as_it_is(campaign, capsys):
    """If a controller of the file is best, the saved file is that file, with a comment; a lone table leaves no best out."""
    folder, _ = campaign
    options = ["--best", "force_peak", "--save", str(folder / "saved.toml"), "--brief"]
    (folder / "saved.toml").write_text(CAR)
    with refused("saved.toml already exists, but was not written by --save"):
        main([str(folder / "campaign.toml"), *options])
    (folder / "saved.toml").unlink()
    for _ in range(2):  # it replaces what it wrote
        assert main([str(folder / "campaign.toml"), *options]) == 0
    out = prose(capsys.readouterr().out)
    assert "passive has the best force_peak: force_peak 0. 12 were compared." in out
    assert "variants that are best in no column are omitted" in out
    lines = (folder / "saved.toml").read_text().splitlines()
    added = lines[len(CAR.rstrip().splitlines()) + 1 :]
    assert len(added) == 4
    assert all(line.startswith("# ") for line in added)
    assert [*read_vehicle(folder / "saved.toml").controllers] == [*read_vehicle(folder / "car.toml").controllers]


def test_a_folder_of_drawn_laws_is_verified(campaign, capsys):
    """`--verify` draws the same laws again, and finds every row and its run."""
    folder, _ = campaign
    assert main(["--verify", str(folder / "campaign-results"), "--runs", "8"]) == 0
    assert "8 runs, chosen with seed 0, were repeated and gave the same numbers" in prose(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--best", "colour"], "--best colour: vehicle 'car.toml' has no metric colour; it has"),
        (["--best", "at_stops"], "--best at_stops: vehicle 'car.toml' has no metric at_stops; it has control_energy"),
        (["--best", "ride", "--subject-to", "travel:0.08"], "--subject-to travel: vehicle 'car.toml' has no metric travel; it"),
        (["--best", "ride", "--subject-to", "peak_travel:nan"], "--subject-to peak_travel = 'nan' is not allowed"),
        (["--best", "ride", "--subject-to", "peak_travel:1 kg"], "kg"),
        (["--best", "ride", "--subject-to", "peak_travel"], "--subject-to peak_travel states no limit"),
        (["--best", "ride", "--subject-to", "ride:1", "--subject-to", "ride:2"], "ride already has a limit; give only the"),
        (["--subject-to", "ride:1"], "--subject-to needs --best"),
        (["--save", "x.toml"], "--save needs --best"),
        (["--best", "ride", "--save", "car.toml"], "--save car.toml is an input file; give another file"),
        (["--best", "ride", "--save", "x.txt"], "a vehicle file is TOML"),
    ],
)
def test_bad_requests(tmp_path, monkeypatch, options, said):
    """A request that cannot be met by any campaign, or not by this one, is refused in one line, and nothing is run."""
    check_refused(tmp_path, monkeypatch, FILE, options, said)


@pytest.mark.parametrize(
    ("drawn", "said"),
    [
        (
            "[samples.controllers.hybrid]\ncolour = { uniform = [0, 1] }",
            "'colour' cannot be sampled; sample one of ground_damping, mix, sky_damping",
        ),
        ("[samples.controllers.hybrid]\nmix = { uniform = [0, 2] }", "mix = 2.0 is not allowed; give a number from 0 to 1"),
        (
            "[samples.controllers.hybrid]\nmix = { uniform = [0, 2], relative = true }",
            "vehicle 'car.toml': the vehicle file gives no value of mix, so the distribution cannot be relative",
        ),
        ("[samples.controllers.hybrid]", "[samples.controllers.hybrid] gives no key of the law to sample"),
        ('[samples.controllers.sky]\n"gain[0][1]" = { uniform = [0, 1] }', "'gain[0][1]' cannot be sampled; sample one of gain"),
        ("[samples.controllers.skyhook]\nsky_damping = { uniform = [0, 1] }", "'skyhook' has no numbers to sample"),
        (
            '[samples.controllers.I]\n"gain[0][0]" = { uniform = [0, 1] }',
            "controller 'I' has no numbers to sample, because it is a design",
        ),
        (
            '[samples.controllers.passive]\n"gain[0][0]" = { uniform = [0, 1] }',
            "contains no [controllers.passive]; sample",
        ),
        ('[samples.controllers.written]\n"gain[0][0]" = { uniform = [0, 1] }', "'written' has no numbers to sample"),
        ("[samples.controllers.add]\nmix = { uniform = [0, 1] }", "the campaign has no controller 'add'"),
    ],
)
def test_bad_keys(tmp_path, monkeypatch, drawn, said):
    """A key that a law does not have, or a law without keys, as one that is designed, is refused in one line of the file."""
    text = FILE.partition("[samples]")[0].replace('"sky"]', '"sky", "I", "written"]') + f"[samples]\ncount = 3\n{drawn}\n"
    check_refused(tmp_path, monkeypatch, text, [], said)


def test_what_cannot_be_saved_is_refused_before_the_runs(tmp_path, monkeypatch):
    """A name that is taken, or a campaign of several vehicles, leaves nothing to be written: one line, and nothing is run."""
    save = ["--best", "ride", "--save", "tuned.toml"]
    taken = CAR + '[controllers.hybrid_tuned]\nsemi_active = "add"\n'
    check_refused(tmp_path, monkeypatch, FILE, save, "already has a controller 'hybrid_tuned'", taken)
    laws = ['skyhook = { semi_active = "skyhook" }', 'hybrid = { semi_active = "hybrid" }']
    laws.append('sky = { measured = ["sprung_velocity"], gain = [[-1e3]] }')
    inline = f"controllers = {{ {', '.join(laws)} }}\n{CAR.partition('[controllers')[0]}"
    check_refused(tmp_path, monkeypatch, FILE, save, "write each controller as [controllers.NAME]", inline)
    both = FILE.replace('["car.toml"]', '["car.toml", "quarter_car_semi_active"]')
    check_refused(tmp_path, monkeypatch, both, save, "--save needs a campaign with one vehicle, but this campaign has 2")


def check_refused(tmp_path, monkeypatch, text, options, said, car=CAR):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "car.toml").write_text(car)
    (tmp_path / "law.py").write_text("def step(y, t, h):\n    return [0.0]\n")
    (tmp_path / "campaign.toml").write_text(text)
    with refused(said):
        main(["campaign.toml", *options])
    assert {path.name for path in tmp_path.iterdir()} == {"car.toml", "law.py", "campaign.toml"}


def test_every_variant_is_a_point(campaign, capsys):
    """For a drawn law `--json` has the root mean squares of each variant, road by road; the picture has them as points."""
    folder, rows = campaign
    entries = answer(capsys, main, str(folder / "campaign.toml"))["summary"]
    read = read_campaign(folder / "campaign.toml")
    figure = trade_off(Plan(read, {"car.toml": {}}), entries, {})
    assert figure is not None
    panels = figure.panels
    assert {entry["controller"] for entry in entries if "variants" in entry} == {"hybrid", "sky"}
    for entry in entries:
        of_law = candidates([row for row in rows if (row["controller"], row["road"]) == (entry["controller"], entry["road"])])
        points = [(over_runs(some, LOAD), over_runs(some, RIDE)) for some in of_law.values()]
        assert "variants" not in entry or [(one["load"], one["ride"]) for one in entry["variants"]] == points
        (panel,) = [one for one in panels if entry["road"] in one.title]
        (curve,) = [one for one in panel.curves if one.label == entry["controller"]]
        assert [*zip(curve.x, curve.y, strict=True)] == points
