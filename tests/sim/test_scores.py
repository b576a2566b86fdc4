"""Which controller is best: the table at the end of commands that run several, and what it says of the best."""

from dataclasses import replace

import numpy as np

from models.vehicle.vehicle import read_vehicle
from sim import bump
from sim.studies.ride.score_table import compared_table, score_lines
from sim.studies.ride.scores import FIELDS, KEYS, Score, best, score_of
from tests.support.commands import answer

RUN = ["--controller", "I", "--controller", "II_printed", "--no-logs", "--duration", "1"]


def test_passive_comes_first(capsys):
    """Passive is compared though not requested; in brief a command prints the comparison, and ends in the verdicts."""
    assert bump.main([*RUN, "--brief"]) == 0
    printed = capsys.readouterr().out
    result = answer(capsys, bump.main, *RUN)
    compared = result["compared"]["controllers"]
    assert [one["controller"] for one in compared] == ["passive", "I", "II_printed"]
    fault = "disk margin below 0.3"
    scores = [Score(one["controller"], {key: one[key] for key in KEYS}, fault * (one["controller"] == "I")) for one in compared]
    assert min(compared, key=lambda one: one["ride"])["controller"] == "I"  # but its margin is 0.19, so it gets no star
    assert best(scores)["ride"] == ["II_printed"]
    assert f"*: best without I ({fault});" in " ".join(printed.split())
    assert best(scores) == result["compared"]["best"]
    for one, run in zip(compared[1:], result["runs"], strict=True):
        assert one["peak_travel"] == run["signals"]["suspension_deflection"]["peak"]["mujoco"]
    assert printed.splitlines()[-2].startswith("I, II_printed: MuJoCo agrees with the model; ")


def test_a_table():
    """The best of each column is marked, changes stand beside ride, travel and load, and who broke off has no numbers."""
    numbers = {
        "passive": (0.5272, 0.0735, 0.359, 0.002063, 0.0, 0.0, 0.01),
        "I": (0.41, 0.0496, 0.371, 0.0027, 211.2, 1228.0, 0.0),
        "a_longer_name": (None,) * 7,
        "II": (0.4101, 0.0735, 0.36, 0.0, 99.97, 629.1, 0.0),
    }
    scores = [Score(name, dict(zip(KEYS, values, strict=True))) for name, values in numbers.items()]
    assert score_lines(scores, "MuJoCo, from 6 s on") == [
        "                             peak     dynamic    off the force, force,    at",
        "                  ride     travel        load     ground    rms   peak stops",
        "  controller    [m/s²]   %   [mm]   %     [-]  %     [%]    [N]    [N]   [%]",
        "  passive       0.527    -  73.5    -  0.359*  -  0.206      0      0  1.00",
        "  I             0.410* -22  49.6* -33  0.371  +3  0.270    211   1228     0*",
        "  a_longer_name     -    -     -    -      -   -      -      -      -     -",
        "  II            0.410* -22  73.5    -  0.360   0      0*   100*   629*    0*",
        "  Worst point of the vehicle in MuJoCo, from 6 s on. *: best; %: change from",
        "  passive.",
    ]


def test_columns_of_travel_have_one_unit():
    """Travel in bump and rebound are columns in mm, with the strokes below; different strokes make columns in per cent."""
    strokes = {"bump": (0.0395, 0.085), "rebound": (0.0264, 0.095)}
    rows = [Score(name, dict.fromkeys(KEYS, 1.0), strokes=strokes) for name in "ab"]
    table = compared_table(rows, "MuJoCo")
    cells = dict(zip(table.headings, table.rows[0], strict=True))
    assert (cells["bump travel [mm]"], cells["rebound travel [mm]"]) == ("39.5", "26.4")
    assert "stroke 85 mm in bump, 95 mm in rebound" in table.caption
    table = compared_table([rows[0], replace(rows[1], strokes={"bump": (0.04, 0.05)})], "MuJoCo")
    cells = [dict(zip(table.headings, row, strict=True)) for row in table.rows]
    assert [(one["bump used [%]"], one["rebound used [%]"]) for one in cells] == [("46", "28"), ("80", "-")]


def test_the_best_is_best():
    """Nobody has less than the best, to the digits shown; and where all are alike, or one is alone, nobody is called best."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        values = [None if rng.random() < 0.2 else round(10 ** rng.uniform(-3, 3), 3) for _ in range(rng.integers(1, 6))]
        names = [f"c{i}" for i in range(len(values))]
        there = {name: value for name, value in zip(names, values, strict=True) if value is not None}
        found = best([Score(name, dict.fromkeys(KEYS, value)) for name, value in zip(names, values, strict=True)])
        for one in FIELDS:
            shown = {name: float(one.digits(value)) for name, value in there.items()}
            least = [name for name in shown if shown[name] == min(shown.values())]
            assert found[one.key] == (least if len({*shown.values()}) > 1 else [])


def test_no_force_is_no_merit():
    """The passive suspension is not the best of the forces, of which it has none, but may be the best of all else."""
    scores = [Score("passive", dict.fromkeys(KEYS, 0.0)), *(Score(f"c{i}", dict.fromkeys(KEYS, i)) for i in (1.0, 2.0))]
    found = best(scores)
    assert {key for key in KEYS if found[key] == ["c1.0"]} == {"force_rms", "force_peak"}
    assert found["ride"] == ["passive"]


def test_the_worst_point_counts():
    """For a vehicle with several wheels the worst one stands in the table, whichever that is."""
    vehicle = read_vehicle("half_car")
    metrics = {"suspension_deflection_front_peak": 0.03, "suspension_deflection_rear_peak": 0.04, "off_ground_front": 0.1}
    found = score_of(vehicle, "I", metrics).values
    assert (found["peak_travel"], found["off_ground"], found["at_stops"]) == (0.04, 0.1, None)
