"""Several vehicles in one call, runs without a part of the vehicle, strokes, passages, actuators beside dampers, payloads."""

import json
import math
import re

import numpy as np
import pytest

from models.kinds.kind import GRAVITY
from models.roads.loads.choice import choose_load
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.obstacles import Flat, Step
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim import bump
from sim.campaign.__main__ import main as run_campaign
from sim.drive import __main__ as drive
from sim.inspect.__main__ import main as inspect
from sim.runs.by_name import run
from synth.vehicle.designer import Designer
from tests.support.commands import answer, prose, refused

CORNER = """
type = "quarter_car"
[parameters]
sprung_mass = 380.0
unsprung_mass = 42.0
suspension_stiffness = 22000.0
suspension_damping = 1500.0
tyre_stiffness = 190000.0
[performance]
sprung_acceleration = 1.0
control_force = 1e-4
[limits]
suspension_stroke = { bump = 0.07, rebound = 0.08 }
stop_stiffness = [1e5, 0, 4e8]
actuator_force = 400.0
actuator_bandwidth = 50.0
[implementation]
sample_period = 0.005
delay = 1
noise = { sprung_acceleration = 0.05 }
[controllers.leaky]
measured = ["sprung_acceleration"]
A = [[-0.5]]
B = [[1.0]]
C = [[-2000.0]]
D = [[0.0]]
[controllers.firm]
measured = ["sprung_velocity"]
gain = [[-800.0]]
"""
DAMPERS = '[actuators]\nkind = "damper"\nc_min = 400.0\nc_max = 4000.0\n[controllers.sky]\nsemi_active = "skyhook"\n'
BOTH = CORNER.replace("measured", 'actuators = "force"\nmeasured') + DAMPERS


@pytest.fixture
def files(tmp_path):
    """Vehicle files of a corner and of a heavier one with other strokes."""
    van = CORNER.replace("= 380.0", "= 900.0").replace("= 22000.0", "= 52000.0").replace("bump = 0.07", "bump = 0.09")
    texts = {"corner": CORNER, "van": van, "both": BOTH}
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    return {name: str(tmp_path / f"{name}.toml") for name in texts}


def test_several_vehicles_share_a_table(files, tmp_path, capsys):
    """Two vehicles with three controllers answer in 24 lines of 80 columns; each has the runs that it has alone, and a log that
    proves them."""
    options = ["--height", "0.06", "--duration", "0.2", "--timestep", "2.5e-3"]
    pair = ["--vehicle", files["corner"], "--vehicle", files["van"]]
    some = [part for name in ("passive", "leaky", "firm") for part in ("--controller", name)]
    assert bump.main([*pair, *some, *options, "--logs", str(tmp_path / "logs")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 24
    assert all(len(line) <= 80 or "/" in line for line in lines)
    vans = lines[[line.strip() for line in lines].index("van") + 1 :][:3]
    changed = [re.search(r"[+-]\d", line) is not None for line in vans]  # against passive of its own vehicle
    assert [line.split()[0] for line in vans] == ["passive", "leaky", "firm"]
    assert changed == [False, True, True]
    assert inspect([str(path) for path in sorted((tmp_path / "logs").glob("*.mcap"))]) == 0
    both = answer(capsys, bump.main, *pair, *some, *options, "--no-logs")
    alone = answer(capsys, bump.main, "--vehicle", files["van"], *some, *options, "--no-logs")
    assert not any("vehicle" in one for one in (*alone["runs"], *alone["compared"]["controllers"]))
    for one, other in ((alone["runs"], both["runs"]), (alone["compared"]["controllers"], both["compared"]["controllers"])):
        assert [row | {"vehicle": "van"} for row in one] == [row for row in other if row["vehicle"] == "van"]


def test_each_vehicle_has_the_controllers_of_its_file(files, capsys):
    """A vehicle runs the requested controllers that its file has; one that has none is refused, as a vehicle twice is."""
    options = ["--duration", "0.3", "--no-logs", "--json", "--controller"]
    pair = ["--vehicle", files["corner"], "--vehicle", files["both"]]
    assert bump.main([*pair, *options, "firm", "--controller", "sky"]) == 0
    runs = [(one["vehicle"], one["controller"]["name"]) for one in json.loads(capsys.readouterr().out)["runs"]]
    assert runs == [("corner", "firm"), ("both", "firm"), ("both", "sky")]
    for names, words in ((["sky"], "this vehicle has none of the"), (["firm", "--vehicle", files["both"]], "given twice")):
        with refused(words):
            bump.main([*pair, *options, *names])
    with refused("--as simulates exported code, which needs one vehicle"):
        bump.main([*pair, "--as", "folder", *options, "firm"])


@pytest.mark.parametrize(
    ("part", "lines"),
    [
        ("noise", ["noise = { sprung_acceleration = 0.05 }"]),
        ("delay", ["delay = 1"]),
        ("limits", CORNER.splitlines()[12:15]),
        ("lag", ["actuator_bandwidth = 50.0"]),
    ],
)
def test_without_a_part(part, lines):
    """A run without a part is that of a file without its lines, to the last bit, and differs from that as built."""
    text = CORNER
    for line in lines:
        text = text.replace(f"{line}\n", "", 1)
    vehicle, road = parse_vehicle(CORNER), Bump(height=0.12)
    runs = [run(each, "leaky", road, duration=0.5)[0].physics for each in (vehicle, vehicle.without(part), parse_vehicle(text))]
    assert np.array_equal(runs[1].values, runs[2].values)
    assert not np.array_equal(runs[0].values, runs[1].values)
    assert (once := vehicle.without(part)).without(part) is once


def test_what_a_part_costs_is_in_the_table(files, tmp_path, capsys):
    """`--without` adds a row below that as built, passive has none, and the log of all runs proves them."""
    options = ["--vehicle", files["corner"], "--controller", "passive", "--controller", "leaky", "--road", "bump:height=0.05"]
    options += ["--without", "noise", "--without", "lag", "--duration", "0.2", "--timestep", "2.5e-3"]
    result = answer(capsys, drive.main, *options, "--logs", str(tmp_path / "logs"))
    rows = [(one["controller"], one.get("without")) for one in result["compared"]["controllers"]]
    assert rows == [("passive", None), ("leaky", None), ("leaky", "noise"), ("leaky", "lag")]
    assert [one.get("without") for one in result["runs"]] == [None, None, "noise", "lag"]
    assert inspect([result["logs"]["mcap"]]) == 0
    capsys.readouterr()


def test_strokes_used(files, capsys):
    """Travel in bump and in rebound is the largest of MuJoCo's deflections either way."""
    options = ["--vehicle", files["corner"], "--controller", "leaky", "--height", "0.1", "--duration", "1.5", "--no-logs"]
    strokes = answer(capsys, bump.main, *options)["compared"]["controllers"][1]["strokes"]
    deflection = run(parse_vehicle(CORNER), "leaky", Bump(height=0.1), duration=1.5)[0].physics["suspension_deflection"]
    assert strokes["bump"] == {"used": -deflection.min(), "of": 0.07}
    assert strokes["rebound"] == {"used": deflection.max(), "of": 0.08}


def test_an_obstacle_is_measured_over_its_passage(capsys):
    """The ride over an obstacle does not depend on the duration of the run: it ends when the passive car has settled."""
    options = [
        "--vehicle",
        "half_car",
        "--controller",
        "passive",
        "--road",
        "step:start=0.25:edge=0.5",
        "--speed",
        "10",
        "--timestep",
        "2e-3",
    ]
    found = []
    for duration in ("3", "4"):
        found.append(answer(capsys, drive.main, *options, "--duration", duration, "--no-logs"))
    vehicle = read_vehicle("half_car")
    behind = (vehicle.parameters["axle_distance_front"] + vehicle.parameters["axle_distance_rear"]) / 10
    slowest = -np.linalg.eigvals(vehicle.linear_model.A).real.max()
    end = Step(start=0.25, edge=0.5, speed=10.0).duration + behind + math.log(100) / (2 * slowest)
    assert found[0]["measured_from"] == 0.25
    assert found[0]["measured_until"] == pytest.approx(end, abs=2e-3)  # a timestep
    assert all(found[0][key] == found[1][key] for key in ("measured_from", "measured_until", "compared"))
    short, long = ({name: one["mujoco"] for name, one in each["runs"][0]["metrics"].items()} for each in found)
    assert short == long


def test_force_actuators_beside_dampers():
    """Controllers with `actuators = "force"` push as in a file without dampers, and others set dampers as in one without them."""
    both, road = parse_vehicle(BOTH), Bump(height=0.08)
    runs = {one.controller.name: one for one in run(both, ["sky", "leaky", "passive"], road, duration=0.5)}
    limits = CORNER[CORNER.index("actuator_force") : CORNER.index("[implementation]")]
    dampers = CORNER[: CORNER.index("[controllers")].replace(limits, "") + DAMPERS
    for name, text in (("leaky", CORNER), ("sky", dampers)):
        (alone,) = run(parse_vehicle(text), name, road, duration=0.5)
        assert runs[name].passed
        assert np.array_equal(runs[name].physics.values, alone.physics.values)
    assert (
        Designer(both).design("firm").certificate.norm.value
        == Designer(parse_vehicle(CORNER)).design("firm").certificate.norm.value
    )
    assert both.with_common_actuators(["passive", "leaky"]).dampers == {}
    with refused("leaky drive force actuators", "sky drive semi-active dampers"):
        both.with_common_actuators(["leaky", "sky"])


def test_a_payload_has_inertia():
    """Mass, centre and inertia are those of point masses put together, and strokes move by what MuJoCo's springs sink."""
    base = read_vehicle("half_car")
    places = {"driver": (40.0, 0.3, 0.2), "luggage": (90.0, -1.1, 0.4)}
    sections = "".join(f"[payload.{name}]\nmass = {m}\nx = {x}\nz = {z}\n" for name, (m, x, z) in places.items())
    stops = "[limits]\nsuspension_stroke = 0.1\nstop_stiffness = 1e5\n"
    laden, p = parse_vehicle(f"{base.text}\n{stops}{sections}"), base.parameters
    arm = math.sqrt(p["pitch_inertia"] / p["sprung_mass"])  # the body as two halves of its mass, before and behind its centre
    masses = np.array([p["sprung_mass"] / 2] * 2 + [m for m, *_ in places.values()])
    at = np.array([(arm, 0.0), (-arm, 0.0), *((x, z) for _, x, z in places.values())])
    centre = masses @ at / masses.sum()
    expected = {
        "sprung_mass": masses.sum(),
        "pitch_inertia": masses @ ((at - centre) ** 2).sum(axis=1),
        "axle_distance_front": p["axle_distance_front"] - centre[0],
        "axle_distance_rear": p["axle_distance_rear"] + centre[0],
        "centre_height": p["centre_height"] + centre[1],
    }
    assert laden.parameters == pytest.approx({**p, **expected}, rel=1e-12)  # rounding
    loads = tuple(choose_load(f"payload:mass={m}:x={x}") for m, x, _ in places.values())
    (settled,) = run(base, "passive", RoadWithLoads(Flat(), loads), duration=6.0, timestep=2e-3)
    for name, stop in laden.limits.stops(laden.kind.suspensions).items():
        sunk = float(settled.physics[name][-1])
        assert -sunk > 0.001  # each axle sinks, so that the signs are tested
        # relative to the sinking: the car's geometry, and what is left of the motion after 6 s
        assert (stop[0].stroke, stop[1].stroke) == pytest.approx((0.1 + sunk, 0.1 - sunk), abs=-0.01 * sunk)
    assert run(laden, "passive", Bump(height=0.05), duration=0.5)[0].passed
    corner = parse_vehicle(CORNER + "[payload]\nmass = 60.0\n")
    assert corner.limits.stops(corner.kind.suspensions)["suspension_deflection"][0].stroke == pytest.approx(
        0.07 - 60 * GRAVITY / 22000, rel=1e-12
    )  # rounding


def test_the_same_interval_in_any_company(files, tmp_path, capsys):
    """`drive --settle` and a campaign measure the same ride, whatever else is driven; else drive names who settles last."""
    (tmp_path / "one.toml").write_text(
        f"vehicles = ['{files['corner']}']\ncontrollers = ['passive']\nroads = ['iso8608:class=B']\nspeeds = [20.0]\n"
        "duration = 4.0\nsettle = 1.5\ntimestep = 2.5e-3\n"
    )
    results = answer(capsys, run_campaign, str(tmp_path / "one.toml"), "--results", str(tmp_path / "results"))
    options = ["--vehicle", files["corner"], "--class", "B", "--duration", "4", "--timestep", "2.5e-3", "--no-logs"]
    options += ["--controller", "passive"]
    rides = [
        answer(capsys, drive.main, *options, *more, "--settle", "1.5")["compared"]["controllers"][0]["ride"]
        for more in ([], ["--controller", "leaky"])
    ]
    assert rides[0] == pytest.approx(results["compared"][0]["controllers"][0]["ride"], rel=1e-9)  # summed in other blocks
    assert rides[0] == rides[1]
    assert drive.main([*options, "--controller", "leaky"]) == 0
    assert "from 2 s on, half of the run, as `leaky` settles later" in prose(capsys.readouterr().out)
    with refused("--settle 3 s", "0 to 2 s"):
        drive.main([*options, "--settle", "3"])
