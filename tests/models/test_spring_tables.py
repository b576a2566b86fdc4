"""Springs and stops from tables: stops with a gap, elements that add up, signs by heading, preload, and measured loops."""

import json
import re

import numpy as np
import pytest

from models.roads.road import Bump
from models.vehicle.limits_and_implementation import read_limits
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.bump import main
from sim.inspect.__main__ import main as inspect
from sim.runs.report import verdict
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import design
from tests.support.analysed import simulate
from tests.support.commands import prose, refused
from tests.support.curved import curved_text

G = 9.81
STOP = "compression [mm],force [N]\n-80,0\n0,0\n20,0\n30,900\n40,2600\n50,5600\n60,11000\n"
SPRING = "Spring compression [mm];Load [kN]\n0;0\n100;2,0\n150;3,1\n200;4,5\n250;6,2\n"
U, F = np.array([0.02, 0.03, 0.04, 0.05, 0.06]), np.array([0.0, 900.0, 2600.0, 5600.0, 11000.0])  # of that stop


def read_with(folder, more, kind="quarter_car", omit=(), **files) -> Vehicle:
    """A vehicle that ships, without some parameters and with more sections, and files next to it."""
    for name, content in files.items():
        (folder / f"{name}.csv").write_text(content)
    text = read_vehicle(kind).text
    for name in omit:
        text = re.sub(rf"(?m)^{name} = .*\n", "", text)
    (folder / "mine.toml").write_text(f"{text}\n{more}\n")
    return read_vehicle(folder / "mine.toml")


def held(x, table_x, table_force):
    """Force of a table: 0 before its first point, straight between its points, and straight on beyond the last one."""
    last = (table_force[-1] - table_force[-2]) / (table_x[-1] - table_x[-2])
    return np.interp(x, table_x, table_force) + last * np.maximum(x - table_x[-1], 0.0)


def integrated(vehicle: Vehicle, pull, road: Bump, time):
    """Suspension deflections of a passive car over a bump, shape (T, corners), by Runge and Kutta's fourth-order method.

    Newton's equations of a rigid body on N corners, turned by small angles, with the road held at its middle over every step.
    `pull` has the springs' forces over the deflections.
    """
    p, corners = vehicle.parameters, [part.corner for part in vehicle.kind.suspensions]

    def of(name, corner):
        axle = corner.split("_")[0]
        return p.get(f"{name}_{axle}", p.get(name, 0.0))

    x = np.array([0.0 if not c else of("axle_distance", c) * (1 if c.startswith("front") else -1) for c in corners])
    y = np.array([p.get("track", 0.0) / 2 * (1 if c.endswith("left") else -1 if c.endswith("right") else 0) for c in corners])
    m, c, k = (np.array([of(name, one) for one in corners]) for name in ("unsprung_mass", "suspension_damping", "tyre_stiffness"))
    inertia = np.array([p["sprung_mass"], p.get("pitch_inertia", 1.0), p.get("roll_inertia", 1.0)])
    arms = np.stack([np.ones_like(x), -x, y])  # of heave, of pitch with the nose down, and of roll to the right
    n, h = len(corners), float(time[1])
    late = (x.max() - x) / road.speed

    def rate(state, z_r):
        body, wheels, v_body, v_wheels = np.split(state, [3, 3 + n, 6 + n])
        d, v = body @ arms - wheels, v_body @ arms - v_wheels
        force = pull(d) + c * v
        return np.concatenate([v_body, v_wheels, -(arms @ force) / inertia, (force - k * (wheels - z_r)) / m])

    state, found = np.zeros(2 * (3 + n)), []
    for t in time:
        body, wheels = state[:3], state[3 : 3 + n]
        found.append(body @ arms - wheels)
        z_r = np.array([float(road.displacement(np.array(t + h / 2 - one))) for one in late])
        k1 = rate(state, z_r)
        k2 = rate(state + h / 2 * k1, z_r)
        k3 = rate(state + h / 2 * k2, z_r)
        k4 = rate(state + h * k3, z_r)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(found)


SMALL = """[limits.stop]
bump = { compression = [2e-5, 6e-5, 1e-4], force = [0, 4, 16] }
rebound = { deflection = [0, 1e-5, 5e-5], force = [0, 0, 6] }
"""
ELEMENTS = """[
    15e3,
    { deflection = [-1e-4, -2e-5, 0, 1e-4], force = [-0.9, -0.1, 0, 0.4] },
    { compression = [3e-5, 1e-4], force = [0, 3] },
]"""
KINDS = {"quarter_car": ("suspension_stiffness",), "half_car": ("suspension_stiffness_front", "suspension_stiffness_rear")}
KINDS["full_car"] = KINDS["half_car"]


@pytest.mark.parametrize("fault", [1.0, 1.02])
@pytest.mark.parametrize("kind", KINDS)
def test_an_own_integration_has_the_same_motion(kind, fault):
    """Spring, helper and stops with gaps, whose forces add up, move a car as Newton's equations integrated here; 2 % does not."""
    text = curved_text(kind, SMALL, **dict.fromkeys(KINDS[kind], ELEMENTS))
    vehicle = parse_vehicle(text)
    road, time = Bump(height=2.4e-4, length=2.0, speed=12.5), np.arange(500) * 1e-3

    def pull(d):
        helper = np.interp(d, [-1e-4, -2e-5, 0, 1e-4], [-0.9, -0.1, 0, 0.4])
        helper += 1e4 * np.minimum(d + 1e-4, 0) + 4e3 * np.maximum(d - 1e-4, 0)
        stops = held(d, [1e-5, 5e-5], [0, 6 * fault]) - held(-d, [2e-5, 6e-5, 1e-4], [0, 4, 16])
        return 15e3 * d + helper - held(-d, [3e-5, 1e-4], [0, 3]) + stops

    expected = integrated(vehicle, pull, road, time)
    physics = simulate([vehicle], [design(vehicle, "passive")], [road], time).run(0)
    peak = np.abs(expected).max()
    assert -expected.min() > 1e-4
    assert expected.max() > 5e-5, "beyond all tables"
    error = max(np.abs(physics[part.deflection] - expected[:, i]).max() for i, part in enumerate(vehicle.kind.suspensions)) / peak
    assert (error < 1e-6) == (fault == 1), error  # the angles' cosines leave 2e-7


@pytest.mark.parametrize(
    ("more", "omit"),
    [
        ('[limits]\nstop = "bump.csv"', ()),
        ('[limits.stop]\nbump = "bump.csv"', ()),
        ('[curves]\nsuspension_stiffness = [\n  "14 kN/m",  # the coil\n  { file = "bump.csv" },\n]', ["suspension_stiffness"]),
    ],
)
def test_a_bump_stop_over_compression_pushes_the_body_up(tmp_path, capsys, more, omit):
    """Compression is minus deflection: as a stop or beside the spring, the table pushes the body up, and logs prove it."""
    vehicle = read_with(tmp_path, more, omit=omit, bump=STOP)
    d = np.linspace(-0.08, 0.08, 161)
    stops = vehicle.limits.stops_at("")
    spring = vehicle.curves["suspension_stiffness"](d) - 14e3 * d if omit else stops.pull(d) if stops else d
    np.testing.assert_allclose(spring, -held(-d, U, F), atol=1e-8)  # of 22 kN
    assert tmp_path / "bump.csv" in vehicle.files
    (tmp_path / "bump.csv").unlink()
    again = parse_vehicle(vehicle.text)
    assert again.limits == vehicle.limits
    (tmp_path / "again.toml").write_text(vehicle.text)
    capsys.readouterr()
    arguments = ["--vehicle", str(tmp_path / "again.toml"), "--controller", "passive", "--duration", "1", "--logs", str(tmp_path)]
    assert main(arguments) == 0
    said = prose(capsys.readouterr().out)
    assert "agrees" in said
    assert omit or "stops: bump" in said
    assert inspect([str(log) for log in tmp_path.glob("*.mcap")]) == 0


def test_stops_of_axles_with_tables_and_strokes(tmp_path):
    """A table with a stroke is over the compression of both stops; an axle may have others; limits are read back."""
    own = "stop compression [mm], force [kN]\n0, 0\n10, 1\n20, 4\n"
    more = '[limits]\nsuspension_stroke = { bump = 0.06, rebound = 0.07 }\nstop = { file = "own.csv" }\n'
    more += "[limits.rear]\nstop_stiffness = 1e5"
    vehicle = read_with(tmp_path, more, "half_car", own=own)
    front, rear = (vehicle.limits.stops_at(one) for one in ("front", "rear"))
    assert front is not None
    assert rear is not None
    assert front.pull(np.array([-0.08, -0.06, 0.0, 0.08])).tolist() == pytest.approx([-4000, 0, 0, 1000], abs=1e-9)
    assert front.work(np.array([-0.08])) == pytest.approx(0.01 * 500 + 0.01 * 2500)
    assert rear.pull(np.array([-0.08])) == pytest.approx(-2000)
    record = json.loads(json.dumps(vehicle.limits.record))
    of_stops = {key: value for key, value in record.items() if key not in ("actuator_force", "actuator_bandwidth")}
    assert read_limits(of_stops, vehicle.kind.suspensions) == vehicle.limits
    assert (
        vehicle.limits.phrases(vehicle.kind.suspensions)[0]
        == "bump stops with tables at -0.06 m in bump and +0.07 m in rebound (front)"
    )
    assert vehicle.doubts == []
    (run,) = run_controllers(vehicle, [design(vehicle, "passive")], Bump(0.15, 3.0, 8.0), sample_times(vehicle, 0.6, 1e-3))
    assert run.passed
    assert "(bump stop)" in verdict(run).text


HEADINGS = {
    "bump travel [mm], force [N]": -1,
    "jounce (mm), spring force (N)": -1,
    "Suspension Deflection [mm], Load [N]": 1,
    "droop [mm], force [N]": 1,
    "rebound_mm, force_N": 1,
}


@pytest.mark.parametrize("heading", HEADINGS)
def test_a_heading_decides_the_sign(tmp_path, heading):
    """Compression, bump and jounce are positive in compression; extension, rebound, droop and deflection in extension."""
    table = f"{heading}\n-50,-900\n0,0\n50,1500\n"
    vehicle = read_with(tmp_path, '[curves]\nsuspension_stiffness = { file = "a.csv" }', omit=["suspension_stiffness"], a=table)
    at = vehicle.curves["suspension_stiffness"](np.array([-0.05, 0.05]))
    assert at == pytest.approx([-900, 1500] if HEADINGS[heading] > 0 else [-1500, 900])


@pytest.mark.parametrize("heading", ["displacement [mm], force [N]", "x, F", "travel [mm], load [N]", "x [mm], F [N]"])
@pytest.mark.parametrize("more", ['[curves]\nsuspension_stiffness = { file = "a.csv" }', '[limits]\nstop = "a.csv"'])
def test_a_heading_without_a_direction_is_asked_about(tmp_path, heading, more):
    """A spring's or a stop's table that does not tell which direction is positive is refused with that question."""
    with refused("column 1 is called", "which direction is positive? Write compression or extension above it"):
        read_with(tmp_path, more, a=f"{heading}\n-50,-900\n0,0\n50,1500\n")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            'suspension_stroke = 0.07\nstop = "bump.csv"',
            "its table has a gap of 0.02 m, and suspension_stroke is 0.07 m; omit one",
        ),
        ("stop = { compression = [0, 0.01], force = [0, 500] }", "pushes back with 500 N at 0.01 m, without a point of contact"),
        ("stop = { compression = [0.01, 0.02, 0.03], force = [0, 500, -1] }", "bump: its table pulls with 1 N at 0.03 m"),
        ("stop = { compression = [0.01, 0.02, 0.03], force = [0, 500, 400] }", "its force falls to 400 N at its end"),
        ("stop = { compression = [0.01, 0.02], force = [0, 0] }", "has a table without a force against bump or rebound"),
        ("stop = { compression = [10, 20], force = [0, 500] }", "at most 5 m is allowed; give m, not mm"),
        ("stop = { velocity = [0, 1], force = [0, 500] }", "unknown key 'velocity'"),
        ("stop = { compression = [0.01, 0.02] }\nstop_stiffness = 3", "two names of one key; omit one"),
        ("stop = 1e5", "make a bump stop together"),
        ('stop = "gone.csv"', "gone.csv"),
    ],
)
def test_a_stop_that_is_none(tmp_path, more, said):
    """Whatever is wrong with a stop's table is one line that says what, and what to give."""
    with refused(said, "[limits]"):
        read_with(tmp_path, f"[limits]\n{more}", bump=STOP)


def test_preload_is_where_the_spring_carries_the_static_load(tmp_path, capsys):
    """With `preload` the table begins where the spring carries its corner's load; without, the difference is a warning."""
    axles = ["suspension_stiffness_front", "suspension_stiffness_rear"]
    more = '[curves]\nsuspension_stiffness_front = { file = "spring.csv", preload = true }\n'
    helper = "{ deflection = [-0.1, 0, 0.1], force = [-2e3, -600, 800] }"
    more += f'suspension_stiffness_rear = [{{ file = "spring.csv", preload = true }}, {helper}]'
    vehicle = read_with(tmp_path, more, "full_car", axles, spring=SPRING)
    p = vehicle.parameters
    share = p["axle_distance_rear"] / (p["axle_distance_front"] + p["axle_distance_rear"])
    load = p["sprung_mass"] * G / 2 * np.array([share, 1 - share])  # of a front and of a rear corner
    for name, carried in zip(axles, load - [0.0, 600.0], strict=True):
        squeezed = np.interp(carried, [0, 2000, 3100, 4500, 6200], [0, 0.1, 0.15, 0.2, 0.25])
        x = np.array([-0.02, 0.0, 0.03])
        expected = carried - np.interp(squeezed - x, [0, 0.1, 0.15, 0.2, 0.25], [0, 2000, 3100, 4500, 6200])
        rear = np.interp(x, [-0.1, 0, 0.1], [-1400, 0, 1400]) if name.endswith("rear") else 0.0
        np.testing.assert_allclose(vehicle.curves[name](x), expected + rear, atol=1e-8)
    assert vehicle.doubts == []

    one, weight = "{ deflection = [-0.1, 0, 0.1], force = [-5000, -3000, -1000] }", 504.5 * G
    vehicle = read_with(tmp_path, f"[curves]\nsuspension_stiffness = {one}", omit=["suspension_stiffness"])
    assert main(["--vehicle", str(tmp_path / "mine.toml"), "--controller", "passive", "--duration", "0.2", "--no-logs"]) == 0
    said = f"its table carries 3000 N at rest, and the static load is {weight:.1f} N, a difference of {weight - 3000:+.1f} N"
    assert said in capsys.readouterr().err
    moved = f"[curves]\nsuspension_stiffness = {one[:-2]}, preload = {weight} }}"
    with refused(f"its table carries 1000 to 5000 N, and {9e3:.6g} N rest on it"):
        read_with(tmp_path, moved.replace(str(weight), '"9 kN"'), omit=["suspension_stiffness"])
    assert read_with(tmp_path, moved, omit=["suspension_stiffness"]).doubts == []
    with refused("or preload = true for a table that begins at the free length"):
        read_with(
            tmp_path, '[curves]\nsuspension_stiffness = { file = "spring.csv" }', omit=["suspension_stiffness"], spring=SPRING
        )


def test_a_measured_loop_is_its_mean(tmp_path, capsys):
    """Points that go round, of a sine test with gas, noise and hysteresis, are their mean, and the hysteresis is reported."""
    rng, t = np.random.default_rng(0), np.arange(3000) / 1000
    v = 0.6 * np.sin(2 * np.pi * t)

    def mean(v):
        return np.where(v > 0, 1900 * np.tanh(v / 0.35), 700 * np.tanh(v / 0.25))

    force = mean(v) + 80 * np.cos(2 * np.pi * t) + 150 + rng.normal(0, 3, len(t))
    columns = (t, -600 / (2 * np.pi) * np.cos(2 * np.pi * t), 1e3 * v, force)
    sheet = "time [s],displacement [mm],velocity [mm/s],force [N]\n" + "\n".join(
        ",".join(f"{x:.4f}" for x in row) for row in zip(*columns, strict=True)
    )
    vehicle = read_with(tmp_path, '[curves]\nsuspension_damping = { file = "a.csv" }', omit=["suspension_damping"], a=sheet)
    curve, x = vehicle.curves["suspension_damping"], np.linspace(-0.59, 0.59, 119)
    assert np.abs(curve(x) - mean(x)).max() < 0.01 * 1776  # 0.5 % of thinning, and noise
    (note,) = vehicle.doubts
    most, where, rest = (float(found) for found in re.findall(r"(-?[\d.]+) (?:N either|m/s|N at rest)", note))
    assert most == pytest.approx(80, abs=6)  # twice the noise
    assert abs(where) < 0.2  # where the cosine is flat
    assert rest == pytest.approx(150, abs=6)
    assert curve.words.endswith(note.removeprefix("suspension_damping: "))
    assert parse_vehicle(vehicle.text).curves["suspension_damping"].words == curve.words
    assert main(["--vehicle", str(tmp_path / "mine.toml"), "--controller", "passive", "--duration", "0.2", "--no-logs"]) == 0
    assert note in capsys.readouterr().err
