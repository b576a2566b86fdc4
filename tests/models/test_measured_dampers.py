"""Adjustable dampers between two measured curves, and beside curves of springs and dampers."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.semi_active import SemiActive, SemiActiveLaw
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.expected import expect
from synth.vehicle.designer import Designer
from tests.models.test_semi_active_dampers import BOTH, BUMP, DAMPER, QUARTER
from tests.support.commands import attacks, refused
from tests.support.curved import DIGRESSIVE, PROGRESSIVE

LINE = "velocity = [-1.0, 0.0, 1.0], force = [-1000.0, 0.0, 1000.0]"
FRICTION = f"{{ {LINE}, friction = 60.0, friction_velocity = 0.02 }}"


def with_tables(text, **curves):
    """A vehicle file with these tables in place of its parameters."""
    lines = [line for line in text.splitlines() if line.split(" =")[0] not in curves]
    return "\n".join([*lines, "[curves]", *(f"{name} = {table}" for name, table in curves.items()), ""])


ROUGH = with_tables(QUARTER, suspension_stiffness=PROGRESSIVE, suspension_damping=FRICTION)


def runs(text, *names, road=BUMP, duration=1.0):
    """The runs of some controllers."""
    vehicle = parse_vehicle(text)
    laws = {name: one.source for name, one in vehicle.controllers.items() if isinstance(one.source, SemiActiveLaw)}
    controllers = [SemiActive(name, laws[name]) if name in laws else Designer(vehicle).design(name) for name in names]
    return run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, 1e-3))


def test_what_would_feed_energy_in():
    """A digressive curve beside a damper that may be softer than the curve falls is refused in a line; friction is not."""
    with refused("at c_min both together supply energy at -1.5 m/s"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=DIGRESSIVE) + DAMPER)
    falling = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-2000, -1000, 0, 500, 600] }"
    with pytest.raises(InputError, match=r"at 0\.5 m/s\. Give only linear damping and friction"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=falling) + DAMPER)
    late = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-1000, -500, 0, 500, 700] }"
    with pytest.raises(InputError, match="beyond 1 m/s, where its end is extended"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=late) + DAMPER)
    vehicle = parse_vehicle(ROUGH + DAMPER)
    with pytest.raises(InputError, match="suspension_damping = 5000 N s/m"):
        replace(vehicle, parameters={**vehicle.parameters, "suspension_damping": 5000.0}).checked()


SOFT = "{ velocity = [-1.5, -0.6, -0.15, 0.0, 0.15, 0.6, 1.5], force = [-700, -380, -120, 0, 130, 420, 800] }"
HARD = "{ velocity = [-1.5, -0.5, -0.2, 0.0, 0.2, 0.5, 1.5], force = [-2600, -1700, -1000, 0, 1400, 2300, 3600] }"
PAIR = f'[actuators]\nkind = "damper"\nc_min = {SOFT}\nc_max = {HARD}\n'
NAMES = ("skyhook", "skyhook_linear", "groundhook", "hybrid", "add", "pdd", "skyhook_add")
LAWS = "".join(f'[controllers.{name}]\nsemi_active = "{name}"\n' for name in NAMES)
TABLES = [[float(x) for x in text.replace("]", "[").split("[")[i].split(",")] for text in (SOFT, HARD) for i in (1, 3)]


def table(number, v):
    """A curve at velocities within it, from its points as they stand in the file: the softest is 0, the firmest 1."""
    return np.interp(v, TABLES[2 * number], TABLES[2 * number + 1])


# A linear law, those of two values, of any, and of none where the spring's force counts, and each way to be late.
@pytest.mark.parametrize("bend", [1e-12, *attacks([0.0])])
def test_straight_curves_are_numbers(bend):
    """Two straight tables are c_min and c_max, and two that hardly bend give their numbers to 1e-9, by all the code of curves."""
    soft, hard = (
        f"{{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [{-c}, {-c / 2 * (1 + bend)}, 0.0, {c / 2 * (1 + bend)}, {c}] }}"
        for c in (300.0, 4000.0)
    )
    text = f'[actuators]\nkind = "damper"\nc_min = {soft}\nc_max = {hard}\n'
    names = ("sky", "pdd")
    made = parse_vehicle(QUARTER + text)
    if not bend:
        numbers = parse_vehicle(QUARTER + DAMPER)
        assert (made.dampers, made.parameters, made.parts.with_curve) == (
            numbers.dampers,
            numbers.parameters,
            numbers.parts.with_curve,
        )
        return
    for more in ("", "bandwidth = 100.0\n"):
        some, plain = (runs(QUARTER + LAWS + each + more, *names, duration=0.1) for each in (text, DAMPER))
        for one, other in zip(some, plain, strict=True):
            for name in other.physics.names:
                a, b = one.physics[name], other.physics[name]
                far = 1e-9 * np.abs(b).max() if "missing" not in name and name != "damping" else 1e-6 * 4000.0
                assert np.abs(a - b).max() <= far, name


def test_what_a_damper_gives():
    """At every sample its force lies between both tables, what is missing is u* - u, and the extremes are the tables."""
    hard, sky = runs(QUARTER + LAWS + PAIR, "skyhook", "sky", duration=0.35)
    for run in (hard, sky):
        physics = run.physics
        v = physics["suspension_velocity"]
        (one,) = run.vehicle.parts.adjustable
        pull = one.force_at(v, 0.0) - physics["control_force"]
        low, high = table(0, v), table(1, v)
        inside = np.abs(v) < 1.5
        assert np.all((pull - low)[inside] * np.sign(v[inside]) >= -1e-6)
        assert np.all((high - pull)[inside] * np.sign(v[inside]) >= -1e-6)
    v, body = hard.physics["suspension_velocity"], hard.physics["sprung_velocity"]
    pull = hard.vehicle.parts.adjustable[0].force_at(v, 0.0) - hard.physics["control_force"]
    clear = (np.abs(v) > 1e-6) & (np.abs(body) > 1e-6) & (np.abs(v) < 1.5)
    expected = np.where(body * v > 0, table(1, v), table(0, v))
    assert np.abs(pull - expected)[clear].max() < 1e-6
    asked = sky.physics["control_force"] + sky.physics["missing_force"]
    assert np.abs(asked - (-3000.0 * sky.physics["sprung_velocity"] + 500.0 * sky.physics["unsprung_velocity"])).max() < 1e-6
    assert np.abs(sky.physics["missing_force"]).max() > 10.0


def test_the_nominal_setting_is_where_the_parameter_says():
    """The force without a request is the share of both curves whose slope at rest is suspension_damping."""
    vehicle = parse_vehicle(QUARTER + PAIR)
    (one,) = vehicle.parts.adjustable
    assert (one.damper.c_min, one.damper.c_max) == pytest.approx(((800 + 130 / 0.15) / 2, 6000.0), rel=1e-12)
    share = (1000.0 - one.damper.c_min) / (one.damper.c_max - one.damper.c_min)
    v = np.linspace(-1.4, 1.4, 51)
    np.testing.assert_allclose(one.force_at(v, 0.0), (1 - share) * table(0, v) + share * table(1, v), atol=1e-9)
    (fitted,) = vehicle.parts.with_curve
    assert fitted.curve.slope == vehicle.parameters["suspension_damping"]
    assert vehicle.linearised.parts.with_curve == ()
    assert vehicle.with_ideal_actuators.parts.with_curve[0].curve(v) == pytest.approx(fitted.curve(v), abs=1e-9)
    other = replace(vehicle, parameters={**vehicle.parameters, "suspension_damping": 3000.0})
    share = (3000.0 - one.damper.c_min) / (one.damper.c_max - one.damper.c_min)
    np.testing.assert_allclose(
        other.parts.adjustable[0].force_at(v, 0.0), (1 - share) * table(0, v) + share * table(1, v), atol=1e-9
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            f"c_max = {HARD}",
            "c_max = 4000.0",
            r"c_min is a curve, but c_max is a number; give c_min and c_max as two curves, or as two numbers",
        ),
        (HARD, SOFT, r"at -1.5 m/s, the force is -700 N for c_min and -700 N for c_max, but c_max must be the firmest setting"),
        ("-1700, -1000", "-1700, -100", r"at -0.2 m/s, the force is .* N for c_min and -100 N for c_max"),
        ("force = [-2600", "force = [nan", r"^\[actuators.c_max\] force\[0\] = nan is not allowed"),
        (HARD, "{ deflection = [-1.0, 1.0], force = [-1, 1] }", r"c_max 'deflection' is not allowed"),
        (
            "1400, 2300, 3600",
            "1400, 2300, 2310",
            r"last points, c_min continues with a slope of 422.222 N s/m and c_max with a slope of 10 N s/m",
        ),
    ],
)
def test_tables_that_are_none(old, new, said):
    """Whatever is wrong with a pair of tables is one line."""
    with refused(match=said):
        parse_vehicle(QUARTER + PAIR.replace(old, new))


def test_what_else_is_refused():
    """A nominal damper outside the slopes at rest, a curve beside that feeds energy in, a force that is measured, other curves on
    one axle: a line each."""
    with pytest.raises(
        InputError,
        match=r"suspension_damping = 700 N s/m, .* not between c_min = 833.333 and c_max = 6000 N "
        "s/m",
    ):
        parse_vehicle(QUARTER.replace("suspension_damping = 1000.0", "suspension_damping = 700.0") + PAIR)
    falling = "{ velocity = [-1.5, -0.2, 0.0, 0.2, 1.5], force = [-250, -200, 0, 200, 250] }"
    with pytest.raises(InputError, match=r"is parallel to a semi-active damper, .* supply energy"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=falling) + PAIR)
    told = '[controllers.told]\nmeasured = ["sprung_acceleration", "control_force"]\ngain = [[-500.0, 0.1]]\n'
    with pytest.raises(
        InputError, match="measures control_force, but no sensor measures the force of a damper with curves c_min and c_max"
    ):
        parse_vehicle(QUARTER + told + PAIR)
    one_side = f"[actuators.front_left]\nc_min = {SOFT}\nc_max = {HARD.replace('-2600', '-2700')}\n"
    with pytest.raises(
        InputError, match="suspensions with the same parameter suspension_damping_front have different damper curves"
    ):
        parse_vehicle(read_vehicle("full_car").text + PAIR + one_side)


def test_files_hold_them(tmp_path):
    """A CSV and a .dpr file are the tables that stand in them, for all dampers or for one; the text that logs have is whole."""
    (tmp_path / "firm.csv").write_text(
        "velocity [mm/s], force [kN]\n" + "".join(f"{1e3 * v!r}, {1e-3 * f!r}\n" for v, f in zip(*TABLES[2:], strict=True))
    )
    points = "".join(f" {1e3 * v} {f}\n" for v, f in zip(*TABLES[:2], strict=True))
    units = "[UNITS]\n LENGTH = 'mm'\n FORCE = 'newton'\n TIME = 'second'\n"
    (tmp_path / "soft.dpr").write_text(f"{units}[CURVE]\n{{ vel force}}\n{points}")
    named = '[actuators]\nkind = "damper"\nc_min = { file = "soft.dpr" }\nc_max = { file = "firm.csv" }\n'
    half = BOTH.replace("c_min = 300.0\nc_max = 3000.0", 'c_min = { file = "soft.dpr" }\nc_max = { file = "firm.csv" }')
    for text in (QUARTER + named, half):
        (tmp_path / "car.toml").write_text(text)
        vehicle = read_vehicle(tmp_path / "car.toml")
        assert {file.name for file in vehicle.named_files} == {"soft.dpr", "firm.csv"}
        for made in (vehicle, parse_vehicle(vehicle.text)):
            pair = made.parts.adjustable[0].damper.pair
            assert pair is not None
            v = np.linspace(-1.5, 1.5, 31)
            np.testing.assert_allclose(pair.soft(v), table(0, v), atol=1e-9)
            np.testing.assert_allclose(pair.hard(v), table(1, v), atol=1e-9)
    (tmp_path / "firm.csv").write_text("velocity, force\n-1, -1\n1, 1\n")
    with pytest.raises(InputError, match=r"\[actuators.front\] c_max: .*column 1, 'velocity', has no unit"):
        read_vehicle(tmp_path / "car.toml")


def test_passive_is_expected_with_its_curves():
    """Over a random road what is expected of the nominal setting is the line that does on average as its curve does."""
    from models.roads.iso8608 import Iso8608

    vehicle = parse_vehicle(QUARTER + PAIR)
    road = Iso8608("C", 0, 15.0).spectrum
    controller = Designer(vehicle).design("passive")
    found = expect(vehicle, controller, road, 1e-3, 10.0)
    assert found is not None
    assert found.line.vehicle.parameters["suspension_damping"] < 950.0  # the curves bend down
