"""The states of a controller's law as signals of its logs: right in physics and analysis, shown, and proved by inspection."""

import csv
import dataclasses
import itertools
import json

import numpy as np
import pytest
import rerun.blueprint as rrb

from models.kinds.signals import STATE_PREFIX
from models.roads.road import Bump, RoadInput
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import read_vehicle
from sim.bump import main as bump
from sim.drive.drive import FEWEST
from sim.inspect.__main__ import main as inspect
from sim.recording.foxglove_layout import foxglove_layout
from sim.recording.pages import MOST_ACTIVE
from sim.recording.rerun_writer import _comparison, _page
from sim.recording.run_records import run_log
from sim.runs.run import run_controllers, sample_times
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks
from tests.synth.test_laws import REALITIES, controller

EVERY_CASE = [*itertools.product(("velocity", "acceleration"), REALITIES)]


@pytest.mark.parametrize(
    ("name", "what", "reality"),
    [
        *(("quarter_car", *case) for case in EVERY_CASE if case[0] == "acceleration"),
        *attacks([("full_car", *case) for case in EVERY_CASE]),
    ],
)
def test_states_in_physics_are_those_of_the_analysis(name, what, reality):
    """Every state in MuJoCo is the exact sampled one, beside runs whose laws have more states, fewer, or none."""
    implementation, limits = REALITIES[reality]
    vehicle = dataclasses.replace(read_vehicle(name), implementation=implementation, limits=limits)
    some = [controller(vehicle, what, 3), Designer(vehicle).design("passive"), controller(vehicle, what, 5)]
    runs = run_controllers(vehicle, some, Bump(height=1e-3), sample_times(vehicle, 0.4, 1e-3))
    for run, count in zip(runs, (3, 0, 5), strict=True):
        names = [one for one in run.physics.names if one.startswith(STATE_PREFIX)]
        assert names == [f"{STATE_PREFIX}{i}" for i in range(1, count + 1)]
        assert run.physics.signals == run.sampled.signals == run.continuous.signals
        for one in names:
            scale = run.sampled.peak(one)
            assert scale > 0
            # RK4's own error is 1e-6 of a peak; geometry of the full car at 1 mm makes 1e-4.
            off = np.abs(run.physics[one] - run.sampled[one]).max() / scale
            assert off < (1e-6 if name == "quarter_car" else 1e-3)
            # To first order in the sample period, against states that move within 1/300 s.
            late = (implementation.delay + 1) * (implementation.sample_period or 1e-3)
            assert np.abs(run.continuous[one] - run.sampled[one]).max() / scale < 200 * late


def test_threads_have_laws_of_different_orders():
    """States are the same on one thread and on two whose laws have different numbers of states."""
    vehicle, time = read_vehicle("quarter_car"), np.arange(51) * 1e-3
    some = [controller(vehicle, "velocity", order) for order in (1, 3) for _ in range(FEWEST)]
    one, two = (simulate(some, [RoadInput(vehicle, Bump(), time)] * len(some), threads) for threads in (1, 2))
    for i in range(len(some)):
        np.testing.assert_array_equal(one.run(i).values, two.run(i).values)


@pytest.mark.parametrize("how", [Implementation(), Implementation(sample_period=0.004, delay=2)])
def test_states_follow_from_the_measurements(how):
    """At every sample of the law, the logged states are A x_c + B y of those before, and held until then."""
    vehicle = dataclasses.replace(read_vehicle("quarter_car"), implementation=how)
    one = controller(vehicle, "velocity", 4)
    (run,) = run_controllers(vehicle, [one], Bump(), sample_times(vehicle, 0.5, 1e-3))
    steps = round((how.sample_period or 1e-3) / 1e-3)
    law = one.law.sampled(steps * 1e-3)
    x = np.stack([run.physics[f"{STATE_PREFIX}{i}"] for i in range(1, 5)], axis=-1)
    y = np.stack([run.physics[name] for name in one.measured], axis=-1)[::steps]
    due = x[::steps]
    # Sums of a few terms, which are not taken in the same order.
    np.testing.assert_allclose(due[1:], due[:-1] @ law.A.T + y[:-1] @ law.B.T, rtol=0, atol=1e-12 * np.abs(due).max())
    np.testing.assert_array_equal(x, np.repeat(due, steps, axis=0)[: len(x)])
    asked = due @ law.C.T + y @ law.D.T
    came = np.concatenate([np.zeros((how.delay, 1)), asked])[: len(asked)]
    np.testing.assert_allclose(run.physics["control_force"][::steps], came[:, 0], rtol=0, atol=1e-9 * np.abs(came).max())


@pytest.mark.parametrize("period", [0.002, 0.004])
def test_a_discrete_law_keeps_its_own_states(period):
    """For a law of 4 ms, run at that or another period, the logged states are in its coordinates in every response."""
    vehicle = dataclasses.replace(read_vehicle("quarter_car"), implementation=Implementation(sample_period=period))
    given = controller(vehicle, "velocity", 2)
    law = given.law.sampled(0.004)
    (run,) = run_controllers(vehicle, [dataclasses.replace(given, law=law)], Bump(), sample_times(vehicle, 1.0, 1e-3))
    for name in (f"{STATE_PREFIX}1", f"{STATE_PREFIX}2"):
        for other in (run.physics, run.continuous):
            # Tustin's rule and the hold differ by half a sample or so; other coordinates by a factor of 16.
            assert np.abs(other[name] - run.sampled[name]).max() < 0.5 * run.sampled.peak(name)
    assert run.agreement.agrees


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of a law of two states on an accelerometer, and of a static one."""
    folder = tmp_path_factory.mktemp("kept")
    options = ["--vehicle", "quarter_car_accelerometer", "--duration", "0.5", "--logs", str(folder)]
    assert bump([*options, "--controller", "I", "--controller", "accelerometer"]) == 0
    return next(folder.glob("*.mcap"))


def test_inspection_proves_and_exports_them(log, tmp_path, capsys):
    """They are proved from the log, and its CSV has them: of the static controller beside them there are none."""
    assert inspect([str(log), "--json", "--csv", str(tmp_path / "all.csv")]) == 0
    (run,) = [one for one in json.loads(capsys.readouterr().out)["runs"] if one["name"] == "accelerometer"]
    assert ("responses", "holds") in [(one["part"], one["verdict"]) for one in run["findings"]]
    rows = list(csv.DictReader((tmp_path / "all.csv").open()))
    assert not any(name.startswith(f"{STATE_PREFIX}1 I ") for name in rows[0])
    for state in (1, 2):
        three = [f"{STATE_PREFIX}{state} accelerometer {which} [own]" for which in ("mujoco", "sampled", "recomputed")]
        mine = np.array([[float(row[key]) for key in three] for row in rows])
        assert np.ptp(mine[:, 0]) > 0
        np.testing.assert_array_equal(mine[:, 1], mine[:, 2])
        np.testing.assert_allclose(mine[:, 0], mine[:, 1], atol=1e-6 * np.abs(mine[:, 1]).max())  # RK4's own error


def run_of_many_states(count: int):
    """A run of a law with so many states, as it is logged."""
    vehicle = dataclasses.replace(read_vehicle("quarter_car"), limits=Limits())
    (run,) = run_controllers(
        vehicle, [controller(vehicle, "velocity", count)], Bump(height=0.01), sample_times(vehicle, 0.1, 1e-3)
    )
    return run, run_log(run, f"law_{count}")


def plots(part) -> list[str]:
    """Names of the plots of a page of Rerun, in its order."""
    if isinstance(part, rrb.TimeSeriesView):
        return [str(part.name)]
    return [name for each in getattr(part, "contents", ()) if not isinstance(each, str) for name in plots(each)]


@pytest.mark.parametrize("count", [2, 30])
def test_viewers_show_those_that_ask_for_most(count):
    """All states are in the log; a page of its own plots the few whose share of the force has the highest peaks."""
    run, logged = run_of_many_states(count)
    (_, other) = run_of_many_states(3)
    assert sum(name.startswith(STATE_PREFIX) for name in logged.responses["mujoco"].names) == count
    assert isinstance(run.controller, Controller)
    asks = {
        f"{STATE_PREFIX}{i + 1}": np.abs(run.controller.law.C[0, i]) * run.sampled.peak(f"{STATE_PREFIX}{i + 1}")
        for i in range(count)
    }
    most = sorted(asks, key=lambda name: -asks[name])[:MOST_ACTIVE]
    shown = [name.split("   ")[0].replace(" ", "_") for name in plots(_page([logged], logged))]
    assert {name for name in shown if name.startswith(STATE_PREFIX)} == set(most)
    assert not any(name.startswith("controller ") for name in plots(_comparison([logged, other]))), "each has its own"

    layout = json.loads(foxglove_layout([logged]))["configById"]
    curves = [path["value"] for name, panel in layout.items() if name.startswith("Plot!") for path in panel["paths"]]
    for topic in ("mujoco", "linear", "continuous", "difference"):
        assert {one.split(".")[1] for one in curves if one.startswith(f"/{topic}.{STATE_PREFIX}")} == set(most)
    titles = [tab["title"] for name, panel in layout.items() if name.startswith("Tab!") for tab in panel["tabs"]]
    assert titles[-2] == ("controller" if count == 2 else "controller: the 6 of 30 states that contribute most")
