"""Curves of dampers and springs: as data, in MuJoCo, compared with SciPy, in verdicts and logs."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import dataclasses
import re

import numpy as np
import pytest

from models.characteristics import LEAVES
from models.characteristics.curve import ForceCurve
from models.characteristics.curve_reading import FRICTION_ERROR, VELOCITY, read_curves
from models.common.errors import InputError
from models.common.printed import percent
from models.kinds.at_wheels import force_effects
from models.roads.road import Bump
from models.vehicle.mjcf import build_model
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main
from sim.drive.regime import CURVE, REGIME_ENDS, departures, end_times
from sim.inspect.findings import different
from sim.linear.nonlinear_elements import at_rest, at_rest_words
from sim.runs.record import RUN
from sim.runs.report import reasons, verdict
from sim.runs.run import run_controllers, sample_times
from sim.studies.frequency.identification import measure_responses
from synth.controller.report import OF, ideal_lines
from synth.vehicle.designer import design
from tests.support.analysed import simulate
from tests.support.commands import attacks, prose, refused
from tests.support.curved import AXLES, DIGRESSIVE, PROGRESSIVE, curved_text, with_curves

BOTH = {"suspension_damping": DIGRESSIVE, "suspension_stiffness": PROGRESSIVE}
ROAD = Bump(height=0.08, length=5.0, speed=12.5)


def damper(velocity, force, **more) -> ForceCurve:
    """A damper's curve from its table."""
    table = {"velocity": list(velocity), "force": list(force), **more}
    return read_curves({"damping": table}, {"damping": VELOCITY})["damping"]


def random_table(rng):
    """A damper's table with a point at rest, rising and falling, of the velocity's sign."""
    v = np.sort(rng.uniform(-2, 2, 9))
    v[4] = 0.0
    v = np.sort(v)
    force = np.sign(v) * rng.uniform(50, 2000, 9)
    force[0], force[-1] = min(force[0], force[1]), max(force[-1], force[-2])  # its ends do not fall
    return v, force


@pytest.mark.parametrize("seed", range(4))
def test_pieces_make_the_curve(seed):
    """A line and its clipped pieces are the table, whether it rises or falls, and go on beyond it as straight as it ends."""
    v, force = random_table(np.random.default_rng(seed))
    if v[0] >= 0 or v[-1] <= 0:
        pytest.skip("rest is not inside")
    curve, largest = damper(v, force), np.abs(force).max()
    x = np.linspace(v[0], v[-1], 501)
    np.testing.assert_allclose(curve(x), np.interp(x, v, force), atol=1e-12 * largest)  # rounding
    for end, inner in ((0, 1), (-1, -2)):
        slope = (force[end] - force[inner]) / (v[end] - v[inner])
        assert curve(v[end] * 3) == pytest.approx(force[end] + slope * 2 * v[end], rel=1e-12)
    i = int(np.flatnonzero(v == 0)[0])
    assert curve.slope == pytest.approx(np.mean(np.diff(force)[i - 1 : i + 1] / np.diff(v)[i - 1 : i + 1]), rel=1e-12)
    x = np.linspace(-3, 3, 200_001)
    work = np.concatenate([[0.0], np.cumsum((curve.pieces.force(x[1:]) + curve.pieces.force(x[:-1])) / 2 * np.diff(x))])
    assert np.abs(curve.work(x) - (work - np.interp(0, x, work))).max() < 1e-6 * largest  # a sum of 200,000 strips


def test_it_has_left_its_line_where_it_says():
    """`departures_at` is where the difference from the line at rest is a tenth of the largest force, and nothing nearer is."""
    curve = damper([-1.5, -0.6, -0.15, 0.0, 0.15, 0.6, 1.5], [-1350, -750, -262.5, 0, 262.5, 1000, 1900])
    for side, at in zip((-1, 1), curve.departures_at, strict=True):
        assert side * at > 0
        off = np.abs(curve(np.linspace(0, at, 100)) - curve.slope * np.linspace(0, at, 100))
        assert off[-1] == pytest.approx(LEAVES * 1900, rel=1e-12)
        assert off[:-1].max() < off[-1]


def test_a_fine_table_is_fewer_lines_to_the_error_it_says():
    """For thousands of points remain as few lines as will do, no farther from any than is said; more error, fewer lines."""
    v = np.linspace(-2, 2, 4001)
    force = 1500 * np.tanh(2 * v) + 100 * v
    counts = []
    for error in (0.02, 0.005, 0.003):
        curve = damper(v.tolist(), force.tolist(), fit_error=error)
        assert np.abs(curve(v) - force).max() <= error * force.max() * (1 + 1e-9)
        counts.append(len(curve.x) - 1)
        assert (
            f"4001 points replaced by {counts[-1]} straight lines, with errors within {100 * error:g} % of {force.max():.4g} N"
            in curve.words
        )
    assert counts == sorted(counts)
    assert counts[0] < 12
    assert damper([-1, -0.5, 0, 0.5, 1], [-1000, -500, 0, 500, 1000]).pieces.slope.size == 0  # on one line


def test_a_fine_table_has_the_slope_of_its_own_points_at_rest():
    """A thinned table has the slopes of its own points on both sides of a kink at rest: the finer, the nearer to the truth.
    Forces rounded to 1 N give the slope within 2 %."""
    truth, off = 700 / 0.12 + 600, []
    for count in (161, 1001, 8001):
        v = np.linspace(-1.5, 1.5, count)
        force = np.where(v > 0, 900, 500) * np.tanh(v / 0.12) + 600 * v
        curve = damper(v.tolist(), force.tolist())
        assert "replaced by" in curve.words
        for i in (count // 2 - 1, count // 2 + 1):
            assert curve(v[i] / 2) == pytest.approx(force[i] / 2, rel=1e-12)
        off.append(abs(curve.slope - truth))
        assert damper(v.tolist(), np.round(force).tolist()).slope == pytest.approx(truth, rel=0.02)
    assert off[0] > 30 * off[1] > 30 * 50 * off[2]  # chords of tanh have errors of h^2


def test_a_fine_spring_has_its_own_slope_where_another_mass_moves_it():
    """A spring of many points with preload = true has the slope of its own points at rest, for this mass and for another."""
    d = np.linspace(-0.12, 0.2, 803)  # compression [m]; nitrogen with p V^1.3
    force = 4905.0 * (1 - d / 0.33) ** -1.3
    table = f"{{ compression = {d.tolist()}, force = {force.tolist()}, preload = true }}"
    vehicle = parse_vehicle(curved_text(suspension_stiffness=table))
    for mass in (vehicle.parameters["sprung_mass"], 650.0):
        moved, load = vehicle.with_parameters(sprung_mass=mass), 9.81 * mass
        curve, rest = moved.curves["suspension_stiffness"], 0.33 * (1 - (4905.0 / load) ** (1 / 1.3))
        slope = 1.3 / 0.33 * load * (load / 4905.0) ** (1 / 1.3)  # of the formula
        assert moved.parameters["suspension_stiffness"] == pytest.approx(slope, rel=5e-3)  # points every 0.4 mm
        assert len(curve.x) < 27
        assert np.abs(curve(rest - d) - (load - force)).max() < 58.0  # N: 0.5 % of the largest force at the file's mass


def test_friction_is_smooth_to_the_error_it_says():
    """Friction is F tanh(v / v0) to 2 % of F; it is beside the damper, and no part of the slope that analysis takes."""
    v, force = [-1.0, -0.2, 0.0, 0.2, 1.0], [-900.0, -300, 0, 300, 900]
    plain, rough = damper(v, force), damper(v, force, friction=80.0, friction_velocity=0.02)
    at = np.linspace(-0.9, 0.9, 20_001)
    assert np.abs(rough(at) - plain(at) - 80 * np.tanh(at / 0.02)).max() <= 80 * FRICTION_ERROR
    assert rough.slope == plain.slope
    assert rough(-at) == pytest.approx(-rough(at), abs=1e-9)


def test_a_straight_curve_is_the_linear_vehicle(paper):
    """A table that lies on the parameter's line gives the linear vehicle's numbers: nothing is fitted."""
    straight = with_curves(
        suspension_damping="{ velocity = [-1.0, -0.3, 0.4, 1.0], force = [-400.0, -120.0, 160.0, 400.0] }",
        suspension_stiffness="{ deflection = [-0.1, 0.0, 0.1], force = [-1310.0, 0.0, 1310.0] }",
    )
    assert straight.parameters == pytest.approx(paper.parameters, rel=1e-14)
    time = sample_times(paper, 0.3, 1e-3)
    for one in run_controllers(straight, [design(straight, "I")], ROAD, time):
        (plain,) = run_controllers(paper, [design(paper, one.controller.name)], ROAD, time)
        for name in plain.physics.names:
            for response in ("physics", "sampled"):
                a, b = getattr(one, response)[name], getattr(plain, response)[name]
                assert np.abs(a - b).max() <= 1e-9 * np.abs(b).max()
        assert np.isinf(one.agreement.end_times[CURVE.name])


SURFACE = "{ velocity = [-1, 0, 1], deflection = [-0.05, 0.05], force = [[-900, -1500], [0, 0], [700, 1900]] }"


@pytest.mark.parametrize(
    ("kind", "name", "curves"),
    [
        ("quarter_car", "I", BOTH),
        *attacks([("half_car", "passive", AXLES)]),
        ("quarter_car", "passive", {"suspension_damping": SURFACE}),
    ],
)
def test_the_error_of_the_linearisation_is_that_of_a_car_without_curves(kind, name, curves):
    """A run says how far its linearisation is off: as far as MuJoCo's run of the car with these lines."""
    vehicle, time = with_curves(kind, **curves), sample_times(with_curves(kind, **curves), 0.4, 1e-3)
    controller = design(vehicle, name)
    (run,) = run_controllers(vehicle, [controller], ROAD, time)
    straight = simulate([vehicle.linearised], [controller], [ROAD], time).response.run(0)
    peaks = {signal: np.abs(run.physics[signal]).max() for signal in vehicle.linear_model.outputs}
    apart = {signal: np.abs(run.physics[signal] - straight[signal]).max() / (peak or 1.0) for signal, peak in peaks.items()}
    assert run.line_errors == pytest.approx(apart, abs=2e-3 if kind == "half_car" else 1e-5)  # geometry, RK4
    worst = max(apart, key=apart.__getitem__)
    assert apart[worst] > 0.1
    line, off = RUN(run)["linearisation"], f"off by {percent(run.line_errors[worst])} of a peak"
    assert line == {"error": run.line_errors[worst], "signal": worst, "over": "peak in MuJoCo"}
    said = "the nonlinear response with the characteristics applies over the whole run; its linearisation at equilibrium is"
    assert f"{said} {off}" in verdict(run).text
    assert any(off in one.text and f"(worst: {worst})" in one.text for one in reasons(run))
    now = RUN(run)
    older = {key: value for key, value in now.items() if key not in ("linearisation", "reference")}
    for signal, one in now["signals"].items():
        errors = {key: one["error"][key] for key in ("sampled", "continuous")}
        older["signals"] = older["signals"] | {signal: one | {"error": errors}}
    assert not list(different(older, now))  # an older log still proves what it claims
    (linear,) = run_controllers(read_vehicle(kind), [design(read_vehicle(kind), "passive")], ROAD, time)
    assert "; linear analysis applies over the whole run; energy" in verdict(linear).text
    assert not {"linearisation", "reference"} & {*RUN(linear)}


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("{ velocity = [-1.0, 0.0, 1.0], force = [-1.0, 1.0] }", "has 3 values of velocity and 2 of force"),
        ("{ velocity = [-1.0, 1.0, 0.0], force = [-1.0, 0.0, 1.0] }", "from 1 to 0 m/s at point 3; sort the points by velocity"),
        ("{ velocity = [0.1, 1.0], force = [10.0, 100.0] }", "but both sides of equilibrium are needed"),
        (
            "{ velocity = [-1000, 0, 1000], force = [-900, 0, 900] }",
            "at most 50 m/s is allowed; check that the values are in m/s, not in mm/s",
        ),
        ("{ velocity = [-1.0, 1.0], force = [1000.0, -1000.0] }", "its force at -1 m/s is 1000 N, which would supply energy"),
        ("{ velocity = [-1.0, 0.0, 1.0], force = [-800.0, 100.0, 1000.0] }", "its force at rest is 100 N"),
        ("{ velocity = [-1.0, 0.0, 1.0, 2.0], force = [-800, 0, 900, 700] }", "force continues to fall beyond its last point"),
        (
            "{ velocity = [-1e-308, 1e-308], force = [-1, 1] }",
            "velocity goes from -1e-308 to 1e-308 m/s, but it must reach at least 1e-06",
        ),
        ("{ velocity = [-1.0, 1.0], force = [0, 0] }", "the force differs by at most 0 N from the force at rest"),
        ("{ velocity = [-1.0, 1.0], force = [-1, 1], friction = 30 }", "friction_velocity is missing; the friction F tanh"),
        ('{ file = "x.csv" }', "names a file, but a vehicle that is read from text cannot refer to files"),
        ("{ deflection = [-0.1, 0.0, 0.1], force = [1000, 0, -1000] }", "its slope at rest is not above 0"),
        (
            "{ deflection = [-100, 0, 100], force = [-1000, 0, 1000] }",
            "at most 5 m is allowed; check that the values are in m, not in mm",
        ),
    ],
)
def test_a_table_that_is_none(table, said):
    """Whatever is wrong with the table of a damper or a spring is one line that says what, and what to give."""
    name = "suspension_stiffness" if "deflection" in table else "suspension_damping"
    with refused(said, f"[curves] {name}"):
        with_curves(**{name: table})


def test_too_many_points():
    """A curve of a million points is refused."""
    with pytest.raises(InputError, match=r"velocity has 1000000 value.* at most 20000"):
        damper(np.linspace(-1, 1, 1_000_000).tolist(), [0.0, 1.0])


DPR = """$------------------------------------------MDI_HEADER
[MDI_HEADER]
 FILE_TYPE = 'dpr'
[UNITS]
 LENGTH = 'mm'
 ANGLE = 'degrees'
 FORCE = 'newton'
 TIME = 'second'
$------------------------------------------CURVE
[CURVE]
{ vel   force}
 -1500.0 -1350.0
 -600.0  -750.0
 -150.0  -262.5
 0.0     0.0
 150.0   262.5   ! rebound
 600.0   1000.0
 1500.0  1900.0
"""
CSV = "# measured\nvelocity [mm/s]; force (kN)\n" + "\n".join(
    f"{v}; {f}" for v, f in zip([-1500, -600, -150, 0, 150, 600, 1500], [-1.35, -0.75, -0.2625, 0, 0.2625, 1.0, 1.9], strict=True)
)


IN_MILLISECONDS = re.sub(r"(?m)^ ([-\d.]+) ", lambda found: f" {float(found[1]) / 1e3} ", DPR).replace("'second'", "'ms'")


SHEET = "Speed [mm/s],Compression [N],Rebound [N]\n0,0,0\n150,262.5,262.5\n600,750,1000\n1500,1350,1900\n"  # of a dynamometer
BUMPS = "bump velocity [m/s], force [N]\n" + "\n".join(
    f"{-v}, {-f}"
    for v, f in zip([-1.5, -0.6, -0.15, 0, 0.15, 0.6, 1.5], [-1350, -750, -262.5, 0, 262.5, 1000, 1900], strict=True)
)
FILES = {"damper.csv": CSV, "damper.dpr": DPR, "ms.dpr": IN_MILLISECONDS, "dyno.csv": SHEET, "bump.csv": BUMPS}
POINTS = list(zip([-1500, -600, -150, 0, 150, 600, 1500], [-1350, -750, -262.5, 0, 262.5, 1000, 1900], strict=True))
IN_POUNDS = "".join(f"{v / 25.4!r}\t{f / 4.4482216152605!r}\r\n" for v, f in POINTS)
FILES |= {  # as test rigs, spreadsheets and engineers write them
    "pounds.csv": f"\ufeffRun 17\t25\r\nVel (ips)\tForce (lbs)\r\n{IN_POUNDS}",
    "german.csv": "Dämpfer 3\n\nGeschwindigkeit [mm/s];Kraft [N];;\n"
    + "".join(f"{v};{f};;\n".replace(".", ",") for v, f in POINTS),
    "zug.csv": "v [m/s];Druckstufe [N];Zugstufe [N]\n1,5;1350;1900\n0,6;-750;1000\n0,15;-262,5;262,5\n".replace(";-", ";"),
    "mixed.csv": "! a rig\nvelocity [mm/s],force [N]\n" + "".join(f"{v},{f}\n; part\n\n" for v, f in (POINTS[3], *POINTS[::-1])),
    "signed.csv": "speed [mm/s],comp force [N],reb force [N]\n1500,-1350,1900\n0,-9,9\n150,-262.5,262.5\n600,-750,1000\n",
}


@pytest.mark.parametrize(("name", "content"), FILES.items())
@pytest.mark.parametrize("form", ["[curves]\nsuspension_damping = {{ file = '{}' }}", "[curves.suspension_damping]\nfile = '{}'"])
def test_a_table_in_a_file_is_the_table_in_its_place(tmp_path, name, content, form):
    """A CSV file, a dynamometer's sheet or a damper property file, in its units and signs, is the curve of its table in SI."""
    (tmp_path / name).write_text(content)
    text = curved_text(suspension_damping=DIGRESSIVE)
    text = text[: text.index("[curves]")] + form.format(name) + "\n"
    (tmp_path / "mine.toml").write_text(text)
    vehicle, plain = read_vehicle(tmp_path / "mine.toml"), with_curves(suspension_damping=DIGRESSIVE)
    for what in ("x", "force"):
        np.testing.assert_allclose(
            getattr(vehicle.parts.with_curve[0].curve, what), getattr(plain.parts.with_curve[0].curve, what), rtol=1e-12
        )
    assert f"# from '{name}', {len(content.encode())} bytes, SHA-256" in vehicle.text
    again = parse_vehicle(vehicle.text)
    np.testing.assert_array_equal(again.parts.with_curve[0].curve.force, vehicle.parts.with_curve[0].curve.force)
    assert tmp_path / name in vehicle.files


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.csv", "velocity, force [N]\n-1, -10\n1, 10\n", "column 1, 'velocity', has no unit (allowed: cm/s"),
        ("a.csv", "velocity [km], force [N]\n-1, -10\n1, 10\n", "has the unit 'km' (allowed: cm/s, ft/s, in/s, m/s, mm/s"),
        ("a.csv", "speed [m/s], compression [N], rebound [N]\n-1, 10, 10\n1, 20, 20\n", "has a speed below 0; give"),
        ("a.csv", "speed [m/s], compression [N], rebound [N]\n0, 90, -90\n1, 200, 300\n", "has 90 N in "
            "compression and -90 N in rebound at 0 m/s, probably because of a"),
        ("a.csv", "speed [m/s], compression [N], rebound [N]\n1, 190, -10\n2, 200, 300\n", "has 190 N in "
            "compression and -10 N in rebound at 1 m/s, probably because of a"),
        ("a.csv", "velocity [m/s], 2 clicks [N], 6 clicks [N]\n-1, -9, -8\n1, 9, 8\n", "exactly two columns are needed"),
        ("a.csv", "speed [m/s], force [N], rebound clicks [-]\n-1, -9, 8\n1, 9, 8\n", "does not state the positive direction"),
        ("a.csv", 'velocity [m/s], force [N]\n-1, -900\n1, "1,000"\n', "line 3 has '1,000', which may be a thousands "
            "separator; write"),
        ("a.csv", "speed [m/s], force [N]\n-1, -10\n1, 10\n", "'speed [m/s]', which does not state the positive direction;"),
        ("a.csv", "velocity [m/s], force [N]\n-1, -10\n1, x\n", "line 3, column 2: 'x' is not a finite number; give a .csv file"),
        ("a.csv", "deflection [m], force [N]\n-1, -10\n1, 10\n", "columns deflection, force, but needs either velocity and"),
        ("a.dpr", DPR.replace("FORCE = 'newton'", ""), "[UNITS] has no FORCE; give one of"),
        ("a.dpr", DPR.replace("[CURVE]", "[CURVES]"), "has no block [CURVE]"),
        ("a.dpr", DPR.replace("{ vel   force}", "{ disp force}"), "has a table of disp, force in [CURVE]"),
        ("gone.csv", None, "gone.csv"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_curve(tmp_path, name, content, said):
    """Whatever is wrong with a curve's file is one line with its name; a missing unit is asked for, never guessed."""
    if content is not None:
        (tmp_path / name).write_text(content)
    text = curved_text(suspension_damping=f"{{ file = '{name}' }}")
    (tmp_path / "mine.toml").write_text(text)
    with refused(said):
        read_vehicle(tmp_path / "mine.toml")


def test_a_user_sees_it(tmp_path, capsys):
    """The verdict says when the curve leaves its line and by how much."""
    (tmp_path / "mine.toml").write_text(curved_text(suspension_damping=DIGRESSIVE))
    arguments = ["--vehicle", str(tmp_path / "mine.toml"), "--controller", "I", "--duration", "0.3"]
    assert main([*arguments, "--no-logs", "-v"]) == 0
    said = prose(capsys.readouterr().out)
    vehicle = read_vehicle(tmp_path / "mine.toml")
    (run,) = run_controllers(vehicle, [design(vehicle, "I")], Bump(), sample_times(vehicle, 0.3, 1e-3))
    when, (share,) = end_times(vehicle, run.physics)[REGIME_ENDS.index(CURVE)], departures(vehicle, run.physics).values()
    assert f"first differs from its line by 10 % of its largest force at {when:.4g} s" in said
    assert f"suspension_damping differs from its linearisation by up to {100 * share:.2g} % of its largest force" in said


@pytest.mark.parametrize("kind", ["quarter_car", "full_car"])
def test_a_suspension_without_an_actuator_pulls_alike(kind):
    """What a curve's force does where no actuator pushes follows from what the spring's parameter does, and is the same."""
    vehicle = with_curves(kind, **(BOTH if kind == "quarter_car" else AXLES))
    without = tuple(dataclasses.replace(one, force="") for one in vehicle.kind.suspensions)
    other = dataclasses.replace(vehicle, kind=dataclasses.replace(vehicle.kind, suspended=without))
    places = [one.deflection for one in vehicle.parts.with_curve]
    ours, theirs = (force_effects(one.kind, one.parameters, places) for one in (vehicle, other))
    for found, expected in zip(theirs, ours, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_own_kinds_have_curves_where_they_say_so(tmp_path):
    """A kind of one's own names the parameters of its suspensions; where its MJCF does not follow them, that is said."""
    kind = read_vehicle("quarter_car").kind
    source = (
        kind.mjcf.with_suffix(".py").read_text().replace('"suspension_damping"', '"c_strut"').replace('"quarter_car"', '"mine"')
    )
    named = 'suspended=(Suspension("suspension_deflection", "suspension", "control_force", "suspension_stiffness", "c_strut"),),'
    source = source.replace("invariants=INVARIANTS,", named).replace("    Parameters,\n", "    Parameters,\n    Suspension,\n", 1)
    (tmp_path / "mine.py").write_text(source)
    (tmp_path / "mine.xml").write_text(kind.mjcf.read_text())
    text = curved_text(suspension_damping=DIGRESSIVE).replace("suspension_damping", "c_strut").replace('"quarter_car"', '"mine"')
    (tmp_path / "mine.toml").write_text(text)
    vehicle, plain = read_vehicle(tmp_path / "mine.toml"), with_curves(suspension_damping=DIGRESSIVE)
    time = sample_times(vehicle, 0.3, 1e-3)
    found, expected = (simulate([one], [design(one, "passive")], [ROAD], time).run(0) for one in (vehicle, plain))
    np.testing.assert_array_equal(found["suspension_velocity"], expected["suspension_velocity"])

    (tmp_path / "mine.py").write_text(source.replace('p["c_strut"], weight)', "400.0, weight)"))
    with pytest.raises(InputError, match=r"'suspension' has c_strut = 400, but the vehicle file gives 1750\. A curve"):
        build_model(read_vehicle(tmp_path / "mine.toml"), 1e-3)


def test_a_curve_that_bends_at_rest_has_its_line_where_only_that_is_spoken_of():
    """Claims say that they are of the line at rest; with friction, where no road is so small that physics is that line,
    frequency responses have the line in MuJoCo, too, and say so."""
    rough = with_curves(suspension_damping=DIGRESSIVE.replace(" }", ", friction = 40.0, friction_velocity = 0.02 }"))
    smooth = with_curves(suspension_damping=DIGRESSIVE)
    (line,) = ideal_lines(smooth, [design(smooth, "passive")])
    assert (
        line == f"{OF} the linearisation at equilibrium: suspension_damping 1750 N s/m (slope of the whole curve: 666.7 to 1750)."
    )
    assert at_rest(smooth) is smooth
    assert at_rest_words(smooth) == ""
    said = (
        "In these runs, MuJoCo uses straight lines instead of the characteristics of suspension damping, because these "
        "characteristics have a kink at equilibrium"
    )
    assert at_rest_words(rough) == said
    controller = [design(rough, "I")]
    off, near = (
        float(one.error(one.sampled).max())
        for vehicle in (rough, at_rest(rough))
        for one in measure_responses(vehicle, controller, 1e-4, 4e-3, 12.5)
    )
    assert off > 0.1  # friction holds the suspension over 0.1 mm: measured 1.0
    assert near < 1e-3  # RK4's at 4 ms: measured 5e-4
