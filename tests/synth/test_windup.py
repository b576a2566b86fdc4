"""Laws that are unstable by themselves, where forces are clipped: what is only asked for ends no run."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from models.laws.linear import LinearLaw
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.campaign.__main__ import main as campaign
from sim.drive.case import Batch, Case
from sim.drive.drive import drive
from sim.drive.loop import DIVERGENCE_LIMIT, Block
from sim.observers.ends import Ends
from sim.observers.results import BALANCE_TOLERANCE
from sim.runs.record import controller_record
from sim.runs.report import controller_notes, events, reasons, verdict
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride import run_metrics
from sim.studies.validity.regime_map import validity
from sim.studies.validity.report import describe
from synth import design_controllers as design
from synth.command.table import Row, details, record

BUMP = Bump(height=0.02, length=4.0, speed=12.0)
SLOW, FAST = 30.0, 1500.0  # 1/s: beyond 1e10 N within a second, and beyond all numbers within half of it


def section(growth, name="mine"):
    """The section of a law with a pole at this rate [1/s]."""
    law = f"A = [[{growth}]]\nB = [[1.0]]\nC = [[1e4]]\nD = [[-100.0]]\n"
    return f'\n[controllers.{name}]\nmeasured = ["sprung_velocity"]\n{law}'


def semi_active(*growths):
    """A car with an adjustable damper, and a law for each of these rates."""
    head, _, _ = read_vehicle("quarter_car_semi_active").text.partition("[controllers.I]")
    return parse_vehicle(head + "".join(section(each, f"law_{each:g}") for each in growths), source="mine")


def limited(growth, limits):
    """The paper's car with limits, and a law of this rate."""
    return replace(
        parse_vehicle(read_vehicle("quarter_car").text + section(growth, f"law_{growth:g}"), source="mine"), limits=limits
    )


CLIPPED = {
    "damper": lambda growth: semi_active(growth),
    "limit": lambda growth: limited(growth, Limits(actuator_force=50.0)),
    "lag": lambda growth: limited(growth, Limits(actuator_force=50.0, actuator_bandwidth=60.0)),
}


@pytest.fixture(scope="module", params=CLIPPED)
def wound_up(request):
    """A vehicle with a law that asks for more than MuJoCo takes, its controller and its run."""
    vehicle = CLIPPED[request.param](SLOW)
    (controller,) = design(vehicle, [f"law_{SLOW:g}"])
    (run,) = run_controllers(vehicle, [controller], BUMP, sample_times(vehicle, 1.5, 1e-3))
    return vehicle, controller, run


def test_what_is_only_asked_for_ends_no_run(wound_up):
    """A law may ask for 1e15 N behind what clips it: the run goes on, with the force that can be given, and its books balance."""
    vehicle, _, run = wound_up
    states = run.physics["controller_1"]
    assert np.abs(states[-1]) * 1e4 > 1e15
    assert run.broke_off is None
    assert run.passed
    if vehicle.dampers:
        coefficient = run.physics["damping"]
        assert {coefficient.min(), coefficient.max()} == {200.0, 1000.0}
    else:
        assert np.abs(run.physics["control_force"][-1]) == 50.0


def test_a_law_that_is_unstable_by_itself_is_called_so(wound_up):
    """Design and runs say the rate at which such a law grows, and that it winds up where forces are clipped, and only there."""
    vehicle, controller, _ = wound_up
    said = "this law is unstable by itself (a state grows at 30 1/s)"
    row = Row(controller.name, controller, (), ())
    for lines in (controller_notes(vehicle, controller), [one.text for one in details(vehicle, row).statements]):
        assert [line.strip() for line in lines if said in line] == [
            f"{said} and winds up when forces are clipped; anti_windup bounds its states"
        ]
    for found in (controller_record(controller), record(row)):
        assert found["law_growth"] == pytest.approx(SLOW)
    free = replace(vehicle, limits=Limits(), dampers={})
    assert said in controller_notes(free, controller)


@pytest.mark.parametrize(
    ("A", "period", "growth"),
    [
        ([[-1.0, 5.0], [0.0, 2.0]], None, 2.0),
        ([[0.0, 1.0], [0.0, 0.0]], None, 0.0),
        ([[-3.0]], None, 0.0),
        ([[1.1]], 0.01, np.log(1.1) / 0.01),
        ([[1.0]], 0.01, 0.0),
        ([[0.0]], 0.01, 0.0),
    ],
)
def test_growth(A, period, growth):
    """A law grows at the rate of its fastest pole, continuous or discrete; integrators and stable laws do not."""
    k = len(A)
    law = LinearLaw(np.array(A), np.ones((k, 1)), np.ones((1, k)), np.zeros((1, 1)), period)
    assert law.growth == pytest.approx(growth, rel=1e-12)


def test_a_law_that_overflows_breaks_off_and_is_named():
    """If a law's own states overflow the run ends, and everything that speaks of it says that it was the law, not the car."""
    vehicle = semi_active(FAST)
    (controller,) = design(vehicle, [f"law_{FAST:g}"])
    (run,) = run_controllers(vehicle, [controller], BUMP, sample_times(vehicle, 0.6, 1e-3))
    assert run.broke_off is not None
    name, when = run.broke_off
    assert name == "law overflow"
    assert np.all(np.isfinite(run.physics.until(when).values))
    assert np.abs(run.physics.until(when)["controller_1"][-1]) > 1e300
    found = run_metrics.measure_run(run, first=100)
    metrics = run_metrics.basis(run, found)
    text = "\n".join([*(one.text for one in reasons(run)), verdict(run).text, *metrics])
    assert f"law overflow: the states of the control law overflow; from {when:.4g} s on, the law requests no finite force" in text
    assert f"This run has no metrics: law overflow at {when:.4g} s." in text
    assert "diverge" not in text
    assert "no vehicle" not in text
    assert (when, "law overflow") in events(run)
    assert run.passed
    cells = validity(vehicle, controller, [BUMP, replace(BUMP, height=0.03)], sample_times(vehicle, 0.6, 1e-3))
    assert all(one.broke_off == "law overflow" and one.missing > 0.9 for one in cells.driven.values())
    assert "In 100.0 % of these runs, the states of the law overflow" in str(describe(cells))


def test_a_request_that_swings_behind_a_lag():
    """A force that changes from one limit to the other within a step is that of the request behind the lag: in the steps of the
    vehicle's equations, and in the energy balance, which is of second order there.
    """
    law = "A = [[30.0, -90.0], [90.0, 30.0]]\nB = [[1.0], [0.0]]\nC = [[1e6, 0.0]]\nD = [[0.0]]\n"
    text = f'{read_vehicle("quarter_car").text}\n[controllers.swings]\nmeasured = ["sprung_velocity"]\n{law}'
    limits = Limits(actuator_force=1500.0, actuator_bandwidth=60.0)
    vehicle = replace(parse_vehicle(text, source="mine"), limits=limits, implementation=Implementation(sample_period=4e-3))
    controllers = design(vehicle, ["swings"])
    (coarse,), (fine,) = (run_controllers(vehicle, controllers, BUMP, sample_times(vehicle, 1.5, h)) for h in (2e-3, 5e-4))
    left = list[float]()
    for run in (coarse, fine):
        assert np.abs(run.physics["controller_1"]).max() * 1e6 > 1e15
        steps, energy = run.agreement.steps, run.energy
        assert steps is not None
        assert energy is not None
        assert steps.agrees
        assert energy.balances
        assert energy.allowed == BALANCE_TOLERANCE  # what is left over is RK4's at once, without a look at half the step
        left.append(energy.residual)
    assert left[0] / left[1] > 4  # at least first order in a quarter of the step; measured 47


def test_a_batch_keeps_what_others_ask_for():
    """A law that overflows in a batch neither ends the runs beside it nor cuts what their laws ask for."""
    vehicle = semi_active(FAST, SLOW)
    controllers = design(vehicle, [f"law_{FAST:g}", f"law_{SLOW:g}"])
    missing = [signal.name for signal in vehicle.kind.signals].index("missing_force")

    class Last:
        def __init__(self, batch: Batch) -> None:
            self.missing = np.zeros(len(batch.cases))

        def take(self, block: Block) -> None:
            self.missing = block.values[-1, missing].copy()

        def result(self) -> list[float]:
            return self.missing.tolist()

    cases = [Case(vehicle, one, BUMP) for one in controllers]
    ends, last = drive(cases, sample_times(vehicle, 1.2, 1e-3), Ends, Last, streamed=True)
    assert [one.law_diverged for one in ends] == [True, False]
    assert [math.isfinite(one.diverged) for one in ends] == [True, False]
    assert abs(last[0]) <= DIVERGENCE_LIMIT
    assert abs(last[1]) > 1e10


def test_a_campaign_says_why_runs_broke_off(tmp_path, capsys):
    """A run whose law overflows is a row that says so; with anti-windup the same law does not, and is verified."""
    kept = section(FAST, "kept") + "anti_windup = 20.0\n"
    (tmp_path / "mine.toml").write_text(semi_active(FAST).text + kept)
    text = f'vehicles = ["mine.toml"]\ncontrollers = ["law_{FAST:g}", "kept"]\nroads = ["bump:height=0.02"]\n'
    (tmp_path / "campaign.toml").write_text(f"{text}speeds = [20.0]\nduration = 0.6\n")
    arguments = [str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "results")]
    assert campaign([*arguments, "--json"]) == 0
    entry, bounded = json.loads(capsys.readouterr().out)["summary"]
    assert (entry["broke_off"], bounded["broke_off"]) == (1, 0)
    assert entry["first_reason"].startswith("law overflow: the states of the control law overflow; from 0.")
    assert campaign(["--verify", str(tmp_path / "results")]) == 0


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(6))
def test_random_unstable_laws(seed):
    """Whatever a random unstable law asks for behind a damper, its run holds, and breaks off by its law alone."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 5))
    A = rng.normal(size=(k, k)) * 10 ** rng.uniform(0, 3)
    A += (10 ** rng.uniform(-1, 3) - np.linalg.eigvals(A).real.max()) * np.eye(k)
    law = LinearLaw(A, rng.normal(size=(k, 2)), 1e3 * rng.normal(size=(1, k)), 100 * rng.normal(size=(1, 2)))
    matrices = "".join(f"{name} = {getattr(law, name).tolist()}\n" for name in "ABCD")
    head, _, _ = read_vehicle("quarter_car_semi_active").text.partition("[controllers.I]")
    text = f'{head}\n[controllers.mine]\nmeasured = ["suspension_deflection", "sprung_velocity"]\n{matrices}'
    vehicle = parse_vehicle(text, source="mine")
    controllers = design(vehicle, ["mine"])
    (run,) = run_controllers(vehicle, controllers, BUMP, sample_times(vehicle, 1.0, 1e-3))
    assert run.passed, reasons(run)
    assert run.broke_off is None or run.broke_off[0] == "law overflow"
