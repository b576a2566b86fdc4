"""Dampers over velocity and deflection: as data, in the exact response and in MuJoCo, in verdicts, expectations and campaigns."""

import numpy as np
import pytest

from models.roads.iso8608 import Iso8608
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.run import sample_times
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import Meter
from sim.studies.ride.statistical_linearisation import equivalent
from sim.studies.stability.step_derivative import step_derivative
from synth.vehicle.designer import design
from tests.support.analysed import sampled_response, simulate
from tests.support.commands import refused
from tests.support.curved import curved_text, with_curves

V = np.array([-0.9, -0.3, 0.0, 0.25, 0.8])
D = np.array([-0.04, -0.012, 0.01, 0.035])  # a soft zone near equilibrium, as of a bypass
F = np.array(
    [[-1500, -900, -860, -1300], [-640, -370, -400, -570], [0, 0, 0, 0], [720, 410, 380, 600], [1700, 1250, 1300, 1650.0]]
)
ROAD = Bump(height=0.09, length=3.0, speed=12.5)
DAMPERS = {"quarter_car": ("",), "half_car": ("_front", "_rear"), "full_car": ("_front", "_rear")}


def table(v=V, d=D, force=F) -> str:
    """A table as it is written in a vehicle file."""
    return f"{{ velocity = {v.tolist()}, deflection = {d.tolist()}, force = {force.tolist()} }}"


def tabled(kind="quarter_car", more="", v=V, d=D, force=F):
    """A vehicle with this table in place of all its dampers."""
    return with_curves(kind, more, **{f"suspension_damping{end}": table(v, d, force) for end in DAMPERS[kind]})


def bilinear(v, d, force=F, ratio=None):
    """The force from the table's definition: along the deflection, which ends flat, then along the velocity, which goes on."""
    r = 1.0 if ratio is None else np.interp(d, D, ratio)
    u, column = r * v, np.array([np.interp(d, D, row) for row in force])
    i = np.clip(np.searchsorted(V, u) - 1, 0, len(V) - 2)
    return r * (column[i] + (column[i + 1] - column[i]) * (u - V[i]) / (V[i + 1] - V[i]))


def test_a_table_without_effect_of_deflection_is_the_curve():
    """Columns that are all alike give the response, MuJoCo's run, the derivative of its step and the expectation of the curve."""
    v = np.array([-1.5, -0.6, -0.2, 0.0, 0.2, 0.6, 1.5])
    force = np.repeat(np.array([[-1350, -750, -350, 0, 350, 1000, 1900.0]]).T, 2, axis=1)
    curve = with_curves(suspension_damping=f"{{ velocity = {v.tolist()}, force = {force[:, 0].tolist()} }}")
    surface, passive = tabled(v=v, d=np.array([-0.1, 0.1]), force=force), design(curve, "passive")
    time, road = sample_times(curve, 0.4, 1e-3), Iso8608("C", 0, 20.0).spectrum

    def line(car):
        found = equivalent(car, passive, road, 1e-3)
        assert found is not None
        return found.vehicle.parameters["suspension_damping"]

    for of in (
        lambda car: sampled_response(car, passive, ROAD, time).values,
        lambda car: simulate([car], [passive], [ROAD], time).run(0).values,
        lambda car: step_derivative(car, 1e-3).A,
        line,
    ):
        np.testing.assert_allclose(of(surface), of(curve), rtol=1e-9, atol=1e-9)


@pytest.mark.attack
def test_expected_values_over_random_roads():
    """Expected ride, travel and load of a table are within 3 % of the root mean square of many of MuJoCo's runs."""
    vehicle, seeds, h = tabled(), 100, 4e-3
    passive, time = design(vehicle, "passive"), sample_times(vehicle, 17.0, h)
    roads = [Iso8608("C", seed, 20.0) for seed in range(seeds)]
    values = simulate([vehicle] * seeds, [passive] * seeds, roads, time, threads=0).response.values
    meter = Meter([vehicle] * seeds, h, round(8.0 / h))
    meter.update(np.moveaxis(values, 0, -1))
    found, expected = meter.result(), expect(vehicle, passive, roads[0].spectrum, h, 9.0)
    assert expected is not None
    for metric in ("sprung_acceleration_weighted", "suspension_deflection_rms", "dynamic_load"):
        assert expected.mean[metric] == pytest.approx(np.sqrt(np.mean(found[metric] ** 2)), rel=0.03), metric


ACROSS = "velocity [mm/s] / deflection [mm] / force [kN]"
SQUEEZED = "compression velocity (m/s) \\ compression (mm) \\ force (N)"


def rows(first, v, d, force, mark=","):
    """The lines of a sheet."""
    return "\n".join([mark.join([first, *map(str, d)]), *(mark.join(map(str, row)) for row in np.column_stack([v, force]))])


FILES = {
    "list": "velocity [m/s], deflection [mm], force [N]\n" + "\n".join(f"{v}, {1e3 * d}, {bilinear(v, d)}" for d in D for v in V),
    "sheet": rows(ACROSS, 1e3 * V, 1e3 * D, F / 1e3, ";").replace(".", ","),
    "words": "velocity [m/s], comp deflection [mm], comp force [N]\n"
    + "\n".join(f"{-v}, {-1e3 * d}, {-bilinear(v, d)}" for d in D for v in V),
    "compression": "# of a rig\n" + rows(SQUEEZED, -V, -1e3 * D, -F),
}


@pytest.mark.parametrize("form", FILES)
def test_a_file_is_the_table_in_its_place(tmp_path, form):
    """A sheet or a list, in its units and signs, is the table of the vehicle file; the text that is read has its numbers."""
    (tmp_path / "damper.csv").write_text(FILES[form])
    (tmp_path / "mine.toml").write_text(curved_text(suspension_damping='{ file = "damper.csv" }'))
    vehicle, plain = read_vehicle(tmp_path / "mine.toml"), tabled()
    for what in ("velocities", "deflections", "table", "slope"):
        for read in (vehicle, parse_vehicle(vehicle.text)):
            np.testing.assert_allclose(
                getattr(read.parts.with_curve[0].curve, what), getattr(plain.parts.with_curve[0].curve, what), rtol=1e-12
            )


WRONG = [
    (FILES["list"].rsplit("\n", 1)[0], "has 19 rows for 5 velocities and 4 deflections; give one row for each pair"),
    (
        FILES["sheet"].replace(ACROSS, "v"),
        "its first cell is 'v', but it must contain the quantities with their units; write in this cell: velocity",
    ),
    (
        FILES["sheet"].replace("deflection", "travel"),
        "'travel' does not state the positive direction; write deflection in this heading if extension is",
    ),
    ({"force": F[:4]}, "force has 4 lists with 4 numbers; give 5 lists (one for each velocity), each with 4 numbers"),
    ({"v": V[::-1]}, "velocity goes from 0.8 to 0.25 m/s at point 2; sort the points by velocity, and give each value once"),
    (
        {"v": 1e3 * V},
        "velocity goes from -900 to 800, but at most 50 m/s is allowed; check that the values are in m/s, not in mm/s",
    ),
    ({"v": V + 1}, "velocity goes from 0.1 to 1.8 m/s, but both sides of equilibrium are needed"),
    ({"d": D + 0.1}, "deflection goes from 0.06 to 0.135 m, but it must contain 0"),
    (
        {"force": F + 50},
        "at deflection -0.04 m: its force at rest is 50 N, but a damper has no force at rest; subtract the gas force",
    ),
    ({"force": -F}, "at deflection -0.04 m: its force at -0.9 m/s is 1500 N, which would supply energy"),
    ({"force": F * np.array([[0.1, 1, 1, 1, 1]]).T}, "at deflection -0.04 m: its force continues to fall below its first point"),
    (
        {"more": '[actuators]\nkind = "damper"\nc_min = 300.0\nc_max = 4000.0'},
        "depends on velocity and deflection, but [actuators] gives this suspension",
    ),
]


@pytest.mark.parametrize(("given", "said"), WRONG)
def test_a_table_that_no_damper_has(tmp_path, given, said):
    """Whatever is wrong with a file or a table, or does not go with it, is one line that says what, and what to give."""
    (tmp_path / "damper.csv").write_text(given if isinstance(given, str) else "")
    (tmp_path / "mine.toml").write_text(curved_text(suspension_damping='{ file = "damper.csv" }'))
    with refused(said, "suspension_damping"):
        read_vehicle(tmp_path / "mine.toml") if isinstance(given, str) else tabled(**given)
