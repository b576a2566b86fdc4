"""Springs and stops from tables: stops with a gap, elements that add up, signs by heading, preload, and measured loops."""

import json
import re
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.optimize import brentq

from models.laws.goals import Goals
from models.parts.stops.part import Stops
from models.vehicle.controllers import ControllerEntry
from models.vehicle.limits_and_implementation import read_limits
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.bump import main
from sim.runs.sampled_vehicle import with_sample
from synth.vehicle.multi_objective import family_of
from tests.support.commands import prose, refused

STOP = "compression [mm],force [N]\n-80,0\n0,0\n20,0\n30,900\n40,2600\n50,5600\n60,11000\n"
SPRING = "Spring compression [mm];Load [kN]\n0;0\n100;2,0\n150;3,1\n200;4,5\n250;6,2\n"
OF_FILE = '[curves]\nsuspension_stiffness = { file = "a.csv" }'


def read_with(folder, more, kind="quarter_car", **files) -> Vehicle:
    """A vehicle that ships, with more sections and files next to it, and without the parameters that the sections have."""
    for name, content in files.items():
        (folder / f"{name}.csv").write_text(content)
    text = read_vehicle(kind).text
    for name in re.findall(r"(?m)^suspension_(?:stiffness|damping)\w*", more):
        text = re.sub(rf"(?m)^{name} = .*\n", "", text)
    (folder / "mine.toml").write_text(f"{text}\n{more}\n")
    return read_vehicle(folder / "mine.toml")


def driven(folder, capsys):
    """What `sim.bump` prints of the vehicle there, on stdout and stderr."""
    capsys.readouterr()
    arguments = ["--vehicle", str(folder / "mine.toml"), "--controller", "passive", "--duration", "0.3", "--no-logs"]
    assert main(arguments) == 0
    return map(prose, capsys.readouterr())


def held(x, table_x, table_force):
    """Force of a table: 0 before its first point, straight between its points, and straight on beyond the last one."""
    last = (table_force[-1] - table_force[-2]) / (table_x[-1] - table_x[-2])
    return np.interp(x, table_x, table_force) + last * np.maximum(x - table_x[-1], 0.0)


BESIDE = '[curves]\nsuspension_stiffness = [\n  "14 kN/m",  # the coil\n  { file = "bump.csv" },\n]'


IN_LIMITS, POSITIVE = '[limits.stop]\nbump = "bump.csv"', STOP.replace("compression", "Travel").replace("-80,0\n", "")


@pytest.mark.parametrize(("more", "table"), [('[limits]\nstop = "bump.csv"', STOP), (IN_LIMITS, POSITIVE), (BESIDE, STOP)])
def test_a_bump_stop_over_compression_pushes_the_body_up(tmp_path, more, table):
    """Compression, or a stop's travel from 0 on, is minus deflection: its table pushes the body up."""
    vehicle = read_with(tmp_path, more, bump=table)
    d, stops = np.linspace(-0.08, 0.08, 161), vehicle.limits.stops_at("")
    found = Stops(*stops).pull(d, 0 * d) if stops else vehicle.curves["suspension_stiffness"](d) - 14e3 * d
    np.testing.assert_allclose(found, -held(-d, [0.02, 0.03, 0.04, 0.05, 0.06], [0, 900, 2600, 5600, 11000]), atol=1e-8)
    assert tmp_path / "bump.csv" in vehicle.files
    (tmp_path / "bump.csv").unlink()
    (tmp_path / "mine.toml").write_text(vehicle.text)
    assert read_vehicle(tmp_path / "mine.toml").limits == vehicle.limits


def test_stops_of_axles_with_tables_and_strokes(tmp_path):
    """A table with a stroke is over the compression of both stops, also from MATLAB; an axle may have others; a log has all."""
    savemat(tmp_path / "own.mat", {"compression_mm": [0.0, 10.0, 20.0], "force_kN": [0.0, 1.0, 4.0]})
    more = '[limits]\nsuspension_stroke = { bump = 0.06, rebound = 0.07 }\nstop = { file = "own.mat" }\n'
    vehicle = read_with(tmp_path, f"{more}[limits.rear]\nstop_stiffness = 1e5", "half_car")
    front, rear = (one.part for one in vehicle.parts)
    assert front.pull(np.array([-0.08, -0.06, 0.0, 0.08]), np.zeros(4)).tolist() == pytest.approx([-4000, 0, 0, 1000], abs=1e-9)
    assert front.stored(np.array([-0.08])) == pytest.approx(0.01 * 500 + 0.01 * 2500)
    assert rear.pull(np.array([-0.08]), np.zeros(1)) == pytest.approx(-2000)
    record = {key: one for key, one in json.loads(json.dumps(vehicle.limits.record)).items() if not key.startswith("actuator")}
    assert read_limits(record, vehicle.kind.suspensions) == vehicle.limits
    assert vehicle.limits.phrases(vehicle.kind.suspensions)[0].endswith(
        " tables at -0.06 m in bump and +0.07 m in rebound (front)"
    )


SIGNS = {
    "bump travel [mm], force [N]": -1,
    "jounce_mm, spring_force_N": -1,
    "Deflection [mm], Load [N]": 1,
    "droop (mm), force (N)": 1,
}


@pytest.mark.parametrize(("heading", "sign"), SIGNS.items())
def test_a_heading_decides_the_sign(tmp_path, heading, sign):
    """Compression, bump and jounce are positive in compression; extension, rebound, droop and deflection in extension."""
    vehicle = read_with(tmp_path, OF_FILE, a=f"{heading}\n-50,-900\n0,0\n50,1500\n")
    assert vehicle.curves["suspension_stiffness"].force.tolist() == ([-900, 0, 1500] if sign > 0 else [-1500, 0, 900])


@pytest.mark.parametrize("heading", ["displacement [mm], force [N]", "x, F", "travel [mm], load [N]"])
@pytest.mark.parametrize("more", [OF_FILE, '[limits]\nstop = "a.csv"'])
def test_a_heading_without_a_direction_is_asked_about(tmp_path, heading, more):
    """A spring's or a stop's table that does not tell which direction is positive is refused with that question."""
    with refused("column 1 is called", "does not state the positive direction; add compression or extension to the"):
        read_with(tmp_path, more, a=f"{heading}\n-50,-900\n0,0\n50,1500\n")


OVER_COMPRESSION, OVER_EXTENSION = "compression [mm],force [N]\n70,0\n80,1000\n", "extension [mm],force [N]\n70,0\n80,1000\n"
OWN = "suspension_stroke = { rebound = 0.07 }\n"


@pytest.mark.parametrize(
    "more",
    [
        'stop = { rebound = "over_extension.csv" }',
        f"{OWN}stop = {{ rebound = {{ compression = [0, 0.01], force = [0, 1e3] }} }}",
        f'{OWN}stop = {{ rebound = "100 N/mm" }}',
        'stop = { bump = "over_compression.csv", rebound = "100 N/mm" }\nsuspension_stroke = { rebound = "7 cm" }',
    ],
)
def test_a_rebound_stop_is_the_same_in_each_form(tmp_path, more):
    """A stop that begins at 70 mm and has 100 N/mm pulls alike from a table of either kind and from a number with a unit."""
    files = {"over_compression": OVER_COMPRESSION, "over_extension": OVER_EXTENSION}
    vehicle = read_with(tmp_path, f"[limits]\n{more}", **files)
    (stops,) = (one.part for one in vehicle.parts)
    assert stops.pull(np.array([0.0, 0.07, 0.075, 0.09]), np.zeros(4)).tolist() == pytest.approx([0, 0, 500, 2000], abs=1e-9)


GRID = "velocity [m/s] / deflection [m] / force [N],-0.05,0.03\n-1,-3000,-2000\n0,0,0\n1,4000,3000\n"


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            '[limits]\nstop = { rebound = "c.csv" }',
            "rebound: its table has forces only in compression, and every force in extension is 0",
        ),
        (
            '[limits]\nstop = { bump = "e.csv" }',
            "bump: its table has forces only in extension, and every force in compression is 0",
        ),
        (
            '[limits]\nstop = { bump = "c.csv", rebound = "c.csv" }',
            "or give suspension_stroke if the table is a function of the compression",
        ),
        (
            "[limits]\nstop = { rebound = { deflection = [0.07, 0.08], force = [1, 2] } }",
            "but has no point where contact begins",
        ),
        (
            "[limits]\nsuspension_stroke = { bump = 0.1 }\nstop = { bump = 1e5, rebound = 1 }",
            "stop_stiffness is given without suspension_stroke; give both for rebound",
        ),
        (
            "[limits]\nsuspension_stroke = { bump = 0.1, rebound = 0.1 }\nstop = { bump = 1e5 }",
            "give both for rebound, or neither",
        ),
        ('[curves]\nsuspension_stiffness = { file = "s.csv", preload = true }', "positive in compression, call them compression"),
        (
            '[curves]\nsuspension_damping = [300, { file = "grid.csv" }]',
            "a position-dependent damper cannot be combined with friction or",
        ),
        ('[curves]\nsuspension_damping = { file = "grid.csv", friction = 50 }', "with friction or other elements; give it alone"),
    ],
)
def test_a_table_that_cannot_act_as_given_is_refused(tmp_path, more, said):
    """A stop on the side where its table has no force, reversed signs, or what adds to a table of two arguments: one line."""
    tables = {"c": OVER_COMPRESSION, "e": OVER_EXTENSION, "s": "deflection [mm],force [N]\n0,0\n250,8800\n", "grid": GRID}
    with refused(said):
        read_with(tmp_path, more, **tables)


def test_preload_is_where_the_spring_carries_the_static_load(tmp_path, capsys):
    """With `preload` the table begins where the spring carries its corner's load; without, the difference is a warning."""
    second = "{ deflection = [-0.1, 0, 0.1], force = [-2e3, -600, 800] }"
    more = '[curves]\nsuspension_stiffness_front = { file = "spring.csv", preload = true }\n'
    more += f'suspension_stiffness_rear = [{{ file = "spring.csv", preload = true }}, {second}]'
    vehicle, x = read_with(tmp_path, more, "full_car", spring=SPRING), np.array([-0.02, 0.0, 0.03])
    a, b = (vehicle.parameters[f"axle_distance_{axle}"] for axle in ("front", "rear"))
    squeeze, push = np.array([0, 0.1, 0.15, 0.2, 0.25]), np.array([0, 2000, 3100, 4500, 6200])
    for axle, arm, slope, other in (("front", b, 0, 0), ("rear", a, 14e3, 600)):
        carried = vehicle.parameters["sprung_mass"] * 9.81 / 2 * arm / (a + b) - other
        expected = carried - np.interp(np.interp(carried, push, squeeze) - x, squeeze, push) + slope * x
        np.testing.assert_allclose(vehicle.curves[f"suspension_stiffness_{axle}"](x), expected, atol=1e-8)
    assert vehicle.warnings == []

    # The rear axle of an SUV in DYNA4's format, from a public repository: over compression, with the load of its own body at 0.
    own = "[curves]\nsuspension_stiffness = { compression = [-0.0745, 0, 0.0905], force = [1898, 4756, 9323] }\n[limits.stop]\n"
    own += "bump = { compression = [0.017, 0.027, 0.037, 0.067, 0.077, 0.0905], force = [0, 250, 550, 2100, 4700, 30e3] }"
    weight, vehicle = 504.5 * 9.81, read_with(tmp_path, own)
    said, warned = driven(tmp_path, capsys)
    assert "agrees" in said
    assert f"force at rest is 4756 N, but the static load is {weight:.1f} N, a difference of {weight - 4756:+.1f} N" in warned
    assert read_with(tmp_path, own.replace(" }", f", preload = {weight} }}", 1)).warnings == []
    with refused("its table covers forces from 1898 to 9323 N, but the static load is 10000 N"):
        read_with(tmp_path, own.replace(" }", ', preload = "10 kN" }', 1))
    with refused("or preload = true for a table that begins at the free length"):
        read_with(tmp_path, OF_FILE, a=SPRING)


@pytest.mark.parametrize("turning", [False, True], ids=["at the wheel", "at a ratio over travel"])
@pytest.mark.parametrize("kind", ["quarter_car", "half_car", "full_car"])
def test_a_preloaded_spring_follows_the_mass(tmp_path, kind, turning):
    """A sampled, varied or changed mass, and that of a family, has the spring of a file with that mass, at the load at rest."""
    axles = [""] if kind == "quarter_car" else ["_front", "_rear"]
    more = "[curves]\n" + "".join(f'suspension_stiffness{end} = {{ file = "a.csv", preload = true }}\n' for end in axles)
    ratio, turn = (0.75, -0.3) if turning else (1.0, 0.0)
    table = "{ deflection = [-0.1, 0.0, 0.1], ratio = [0.78, 0.75, 0.72] }"
    more += "".join(f"motion_ratio{end} = {table}\n" for end in axles) * turning
    spring = SPRING.replace("200;4,5\n250;6,2\n", "200;5,5\n250;8,9\n") if kind == "quarter_car" or turning else SPRING
    vehicle = read_with(tmp_path, more, kind, a=spring)
    mass = vehicle.parameters["sprung_mass"]
    (tmp_path / "mine.toml").write_text(vehicle.text.replace(f"sprung_mass = {mass}", f"sprung_mass = {1.1 * mass!r}"))
    heavy = read_vehicle(tmp_path / "mine.toml")
    assert heavy.parameters["sprung_mass"] == 1.1 * mass
    for changed in (
        vehicle.with_parameters(sprung_mass=1.1 * mass),
        with_sample(vehicle, {"sprung_mass": 1.1 * mass}),
        *family_of(vehicle, ControllerEntry("own", ()), Goals(family=({"sprung_mass": 1.1},))),
    ):
        x = np.linspace(-0.04, 0.04, 33)
        for name, curve in heavy.curves.items():
            assert changed.parameters[name] == pytest.approx(heavy.parameters[name], rel=1e-12)
            np.testing.assert_allclose(changed.curves[name](x), curve(x), rtol=1e-9, atol=1e-9 * curve.range)
        np.testing.assert_allclose(changed.linear_model.A, heavy.linear_model.A, rtol=1e-12)
        assert not changed.warnings
    assert any(heavy.parameters[name] != vehicle.parameters[name] for name in heavy.curves)
    squeeze, push = np.loadtxt(spring.replace(",", ".").splitlines()[1:], delimiter=";").T * [[1e-3], [1e3]]
    arms = {end: heavy.parameters.get(f"axle_distance{end}", 0.5) for end in axles}
    for end in axles:
        other = sum(arm for name, arm in arms.items() if name != end) / sum(arms.values()) if end else 1.0
        load = heavy.parameters["sprung_mass"] * 9.81 * other / (2 if kind == "full_car" else 1) / ratio
        rest: Any = brentq(lambda at, load=load: np.interp(at, squeeze, push) - load, 0.0, squeeze[-1])
        rate = np.diff(np.interp([rest - 1e-6, rest + 1e-6], squeeze, push))[0] / 2e-6
        at_wheel = heavy.kind.at_wheels(heavy.parameters)[f"suspension_stiffness{end}"]
        assert at_wheel == pytest.approx(ratio**2 * rate - turn * load, rel=1e-6)
    assert dict(vehicle.with_parameters(**{f"tyre_stiffness{axles[0]}": 2e5}).curves) == dict(vehicle.curves)
    with refused("extend the table"):
        vehicle.with_parameters(sprung_mass=9.0 * mass)


@pytest.mark.parametrize("first", [0, 1], ids=["with time", "without time"])
def test_a_measured_loop_is_its_mean(tmp_path, capsys, first):
    """Points that go round, of a sine test with gas, noise and hysteresis, are their mean, and the hysteresis is reported."""
    rng, turn = np.random.default_rng(0), 2 * np.pi * np.arange(3000) / 1000

    def mean(v):
        return np.where(v > 0, 1900 * np.tanh(v / 0.35), 700 * np.tanh(v / 0.25))

    force = mean(0.6 * np.sin(turn)) + 80 * np.cos(turn) + 150 + rng.normal(0, 3, len(turn))
    rows = zip(turn / 6.28, -95.5 * np.cos(turn), 600 * np.sin(turn), force, strict=True)
    sheet = [["time [s]", "displacement [mm]", "velocity [mm/s]", "force [N]"], *([f"{x:.4f}" for x in row] for row in rows)]
    vehicle = read_with(
        tmp_path, '[curves]\nsuspension_damping = { file = "a.csv" }', a="\n".join(",".join(row[first:]) for row in sheet)
    )
    curve, x = vehicle.curves["suspension_damping"], np.linspace(-0.59, 0.59, 119)
    assert np.abs(curve(x) - mean(x)).max() < 0.01 * 1776  # 0.5 % of thinning, and noise
    (note,) = vehicle.warnings
    number = r"(-?[\d.]+(?:e[+-]\d+)?)"
    pattern = rf"{number} N either way at {number} m/s, {number} N at rest .* {number} N s/m over"
    pattern += rf".* rest {number} N s/m, .* {number} and {number} m/s"
    most, where, rest, energy, slope, low, high = (float(found) for found in re.findall(pattern, note)[0])
    v = 0.6 * np.sin(turn)
    assert energy == pytest.approx(float((force - 150) @ v / (v @ v)), rel=2e-3)  # 4 digits, and the gas to 1 N
    assert slope == pytest.approx(curve.slope, rel=1e-3)
    assert low < 0 < high
    assert curve.slope == pytest.approx(float(curve(np.array(high)) / high + curve(np.array(low)) / low) / 2, rel=1e-2)
    assert most == pytest.approx(80, abs=6)  # twice the noise
    assert abs(where) < 0.2  # where the cosine is flat
    assert rest == pytest.approx(150, abs=6)
    assert parse_vehicle(vehicle.text).curves["suspension_damping"].words == curve.words
    assert note in list(driven(tmp_path, capsys))[1]


DAMPER_OF_FILE = '[curves]\nsuspension_damping = { file = "a.csv" }'


def damper_log() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Six cycles of 18 mm at 1.5 Hz, sampled at 300 Hz with noise: time [s], displacement [m] and force [N] with gas."""
    rng, t = np.random.default_rng(2), np.arange(1200) / 300
    v = 0.018 * 3 * np.pi * np.cos(3 * np.pi * t + 1)
    return t, 0.018 * np.sin(3 * np.pi * t + 1) + rng.normal(0, 5e-6, 1200), law(v) + 150 + rng.normal(0, 0.5, 1200)


def law(v):
    return np.where(v > 0, 900, 500) * np.tanh(v / 0.12) + 600 * v


def stamp(seconds, mark=".", day="") -> str:
    return (
        f"{day}12:59:{58 + seconds:06.3f}".replace(".", mark)
        if seconds < 2
        else f"{day}01:00:{seconds - 2:06.3f}".replace(".", mark)
    )


LOGS = {  # of the headings and a row of the file, each from time, displacement [m] and force [N]
    "stamps": (
        "Timestamp,Force (V),Force (N),Disp (V),Disp (mm)",
        lambda t, x, f: f"{stamp(t, day='2025-11-14 ')},{f / 200},{f},{x},{1e3 * x}",
    ),
    "units below": ("Time\tForce\tForce raw\tTravel\ns\tN\tV\tmm", lambda t, x, f: f"{t:.5f}\t{f}\t{f / 200}\t{1e3 * x}"),
    "German": ("Zeit [ms];Kraft [kN];Weg [mm]", lambda t, x, f: f"{1e3 * t:.3f};{f / 1e3:.6f};{1e3 * x:.5f}".replace(".", ",")),
    "inches": ("time,load [lbf],position [in]", lambda t, x, f: f"{stamp(t)},{f / 4.4482216},{x / 0.0254}"),
    "compression": ("t [s],comp force [N],stroke [mm]", lambda t, x, f: f"{t},{-f},{1e3 * x}"),
}


@pytest.mark.parametrize(("name", "sign"), [*((name, 1) for name in LOGS), ("stamps", -1), ("inches", -1)])
def test_a_raw_log_of_a_dynamometer(tmp_path, name, sign):
    """Force and displacement over time stamps are the damper's law, whichever way the load cell counts, and all is said."""
    head, row = LOGS[name]
    content = "\n".join([head, *(row(t, x, sign * f) for t, x, f in zip(*damper_log(), strict=True))])
    content = content.replace("2025-11-14 01", "2025-11-14 13")  # a clock of 24 hours; the other one has 12
    vehicle = read_with(tmp_path, DAMPER_OF_FILE, a=content)
    v = np.linspace(-0.165, 0.165, 34)
    # Noise of 5 um through a filter of 18 Hz is 0.2 mm/s, at 8 kN s/m 2 N; lines are within 4 N, and bins 2 mm/s wide.
    assert np.abs(vehicle.curves["suspension_damping"](v) - law(v)).max() < 20
    note = next(one for one in vehicle.warnings if "low-pass" in one)
    assert re.search(
        r"low-pass of 1\d\.\d+ Hz \(Savitzky-Golay, order 3, \d+ samples\), last 6 of 6 cycles of 1\.[45]\d* Hz", note
    )
    assert ("the sign of the force is turned" in note) == (sign < 0)
    assert ("displacement counts as positive in extension" in note) == (name != "compression")
    assert ("columns 2 ('Force (V)') and 4 ('Disp (V)') are left out" in note) == (name == "stamps")


def test_a_log_in_matlab_and_a_velocity_of_the_other_sign(tmp_path):
    """Vectors named with units are a log; a loop in which force falls with velocity is turned, and the mean power is given."""
    t, x, f = damper_log()
    savemat(tmp_path / "log.mat", {"time_s": t, "force_N": f, "displacement_mm": 1e3 * x})
    vehicle = read_with(tmp_path, DAMPER_OF_FILE.replace("a.csv", "log.mat"))
    assert vehicle.curves["suspension_damping"](np.array([0.1]))[0] == pytest.approx(law(0.1), rel=0.02)
    rows = "\n".join(f"{a},{-b}" for a, b in zip(1e3 * np.gradient(x, t), f, strict=True))
    vehicle = read_with(tmp_path, DAMPER_OF_FILE, a=f"velocity [mm/s],force [N]\n{rows}")
    assert vehicle.curves["suspension_damping"](np.array([-0.1]))[0] == pytest.approx(law(-0.1), rel=0.03)
    power = np.mean(np.gradient(x, t) * (f - f.mean()))
    assert any(f"the force falls as velocity rises (mean power {-power:.4g} W)" in one for one in vehicle.warnings)


@pytest.mark.parametrize(
    ("above", "columns", "said"),
    [
        ("t [s],force [N]", "tf", "is time, column 2 ('force [N]') is force; columns that are still needed: deflection"),
        ("force [N],travel [mm],temp [C]", "fxf", "column 3 ('temp [C]') is not read; columns that are still needed: time"),
        ("t [s],left force [N],right force [N],travel [mm]", "tffx", "needed: only one of force"),
        (
            "t [s],compression force [N],compression [mm]",
            "tnx",
            "correct the direction that is stated in the heading of column 3 or 2",
        ),
        ("t [s],force [N],travel [mm]", "txx", "the force neither rises nor falls with velocity"),
        ("t [s],force [N],travel [mm]", "ffx", "give a log with a constant sample rate"),
        ("t [s],force [N],travel [mm]", "tft", "the displacement has fewer than two maxima and fewer than two minima"),
    ],
)
def test_a_log_that_is_not_enough(tmp_path, above, columns, said):
    """A log without time, force or displacement is refused with what each column is; so is one whose force is of no damper."""
    t, x, f = damper_log()
    cells = {"t": t, "x": 1e3 * x, "f": f, "n": -f}
    rows = "\n".join(",".join(f"{one:.6g}" for one in row) for row in zip(*(cells[one] for one in columns), strict=True))
    with refused(said):
        read_with(tmp_path, DAMPER_OF_FILE, a=f"{above}\n{rows}")
