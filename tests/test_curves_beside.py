"""Curves of springs and dampers beside adjustable dampers: in MuJoCo, against their exact response, in verdicts and diagrams."""

from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.semi_active import SemiActive
from models.roads.road import Bump
from models.suspension.damper_range import range_of
from models.vehicle.vehicle import parse_vehicle
from sim.inspect.__main__ import main as inspect
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.analysed import energy, simulate
from tests.commands import attacks
from tests.curved import DIGRESSIVE, PROGRESSIVE
from tests.test_dampers import BOTH, BUMP, DAMPER, LATE, QUARTER

LINE = "velocity = [-1.0, 0.0, 1.0], force = [-1000.0, 0.0, 1000.0]"
FRICTION = f"{{ {LINE}, friction = 60.0, friction_velocity = 0.02 }}"
LAWS = "".join(f'[controllers.{name}]\nsemi_active = "{name}"\n' for name in ("skyhook", "add", "hybrid", "pdd"))


def with_tables(text, **curves):
    """A vehicle file with these tables in place of its parameters."""
    lines = [line for line in text.splitlines() if line.split(" =")[0] not in curves]
    return "\n".join([*lines, "[curves]", *(f"{name} = {table}" for name, table in curves.items()), ""])


SPRING = with_tables(QUARTER, suspension_stiffness=PROGRESSIVE)
ROUGH = with_tables(QUARTER, suspension_stiffness=PROGRESSIVE, suspension_damping=FRICTION)


def runs(text, *names, road=BUMP, duration=1.0, step=1e-3):
    """The runs of some controllers."""
    vehicle = parse_vehicle(text)
    laws = {name: entry.semi_active for name, entry in vehicle.controllers.items() if entry.semi_active}
    controllers = [SemiActive(name, laws[name]) if name in laws else Designer(vehicle).design(name) for name in names]
    return run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, step))


def off(run, other, until=np.inf):
    """The largest difference of physics from a response, over its peak, of all output signals."""
    physics, other = run.physics.until(until), other.until(until)
    return max(
        np.abs(physics[name] - other[name]).max() / (other.scale(name) or 1.0) for name in run.vehicle.linear_model.outputs
    )


def check_physics(run, far):
    """MuJoCo is RK4's own arithmetic, this far from the exact response, and no damper drives at any sample."""
    assert run.passed
    assert off(run, run.prediction.integrated) < 1e-9
    assert off(run, run.sampled) < far
    assert run.energy is not None
    assert run.energy.least is not None
    assert run.energy.least >= 0.0


@pytest.mark.parametrize(
    "more",
    [
        pytest.param("", id="", marks=pytest.mark.attack),
        pytest.param("bandwidth = 100.0\n", id="lag", marks=pytest.mark.attack),
        pytest.param(LATE, id="late", marks=pytest.mark.attack),
        pytest.param("bandwidth = 100.0\n" + LATE, id="both"),
    ],
)
@pytest.mark.parametrize(("text", "far"), [(SPRING, 2e-5), *attacks([(ROUGH, 5e-5)])], ids=["spring", "friction"])
def test_the_exact_response(text, far, more):
    """MuJoCo is what RK4 is foretold to make, to rounding, and that is next to the exact response, which decides for itself.

    1e-9: rounding, over 300 steps. 2e-5: RK4 over the knots of a spring at 1 ms, as without adjustable dampers; friction, which
    turns within 0.1 m/s, at most 4e-5.
    """
    for run in runs(text + LAWS + DAMPER + more, "passive", "leaky", "pdd", duration=0.3):
        check_physics(run, far)


@pytest.mark.attack
def test_a_straight_curve_beside_is_none():
    """A table on the parameter's line beside an adjustable damper changes no number by more than rounding."""
    text = with_tables(QUARTER, suspension_damping=f"{{ {LINE} }}")
    some, others = (runs(each + DAMPER, "sky", "leaky", duration=0.2) for each in (text, QUARTER))
    for one, plain in zip(some, others, strict=True):
        for name in plain.physics.names:
            for response in ("physics", "sampled"):
                a, b = getattr(one, response)[name], getattr(plain, response)[name]
                assert np.abs(a - b).max() <= 1e-9 * np.abs(b).max()


@pytest.mark.parametrize("name", ["sky", "skyhook"])
@pytest.mark.attack
def test_a_car(name):
    """On a half-car whose axles differ, one with a lag, all but geometry is exact: over 1 mm within 1e-5 of a peak."""
    rear = "{ deflection = [-0.1, -0.001, 0.0, 0.001, 0.1], force = [-4000, -22, 0, 22, 2600] }"
    front = f"{{ {LINE}, friction = 1.0, friction_velocity = 0.01 }}"
    text = with_tables(BOTH + LAWS, suspension_damping_front=front, suspension_stiffness_rear=rear)
    (run,) = runs(text, name, road=Bump(0.001, 5.0, 12.5), duration=0.4)
    assert run.passed
    assert off(run, run.sampled) < 1e-5
    (whole,) = runs(text, name, road=Bump(0.05, 5.0, 12.5), duration=0.4)
    assert whole.passed
    assert np.isfinite(whole.agreement.ended["curve"])


def test_what_would_feed_energy_in():
    """A digressive curve beside a damper that may be softer than the curve falls is refused in a line; friction is not."""
    with pytest.raises(
        InputError,
        match=r"suspension_damping adds to an adjustable damper, whose softest setting then feeds energy in at -1.5 m/s",
    ) as error:
        parse_vehicle(with_tables(QUARTER, suspension_damping=DIGRESSIVE) + DAMPER)
    assert "\n" not in str(error.value)
    falling = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-2000, -1000, 0, 500, 600] }"
    with pytest.raises(InputError, match=r"at 0\.5 m/s; give only the line and the friction"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=falling) + DAMPER)
    late = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-1000, -500, 0, 500, 700] }"
    with pytest.raises(InputError, match="beyond 1 m/s, as it goes on from there"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=late) + DAMPER)
    vehicle = parse_vehicle(ROUGH + DAMPER)
    with pytest.raises(InputError, match="suspension_damping = 5000 N s/m"):
        replace(vehicle, parameters={**vehicle.parameters, "suspension_damping": 5000.0}).checked()


def test_energy_has_what_stands_beside():
    """Were friction left out of the balance, that would not balance; that the damper takes energy is of both together."""
    vehicle = parse_vehicle(ROUGH.replace("friction = 60.0", "friction = 200.0") + DAMPER)
    controller, time = Designer(vehicle).design("sky"), sample_times(vehicle, 1.0, 1e-3)
    made = simulate([vehicle], [controller], [BUMP], time)
    assert energy(vehicle, made, 0, BUMP).balances
    spring_alone = {name: one for name, one in vehicle.curves.items() if name != "suspension_damping"}
    assert not energy(replace(vehicle, curves=spring_alone), made, 0, BUMP).balances


def test_limits_move_with_the_nominal_damper():
    """The limits of a coefficient beyond the nominal one are from the line at rest, whatever stands beside."""
    of = range_of([parse_vehicle(ROUGH + DAMPER).adjustable], ["control_force"])
    assert (of.low.item(), of.high.item()) == (-700.0, 3000.0)


@pytest.mark.attack
def test_a_log_is_proved_again(tmp_path, capsys):
    """A log of a law on a vehicle with friction and a spring's curve holds as it was written."""
    from sim.bump import main as bump

    (tmp_path / "car.toml").write_text(ROUGH + LAWS + DAMPER)
    told = ["--vehicle", str(tmp_path / "car.toml"), "--controller", "add", "--duration", "0.3", "--logs", str(tmp_path / "logs")]
    assert bump(told) == 0
    capsys.readouterr()
    (log,) = (tmp_path / "logs").glob("*.mcap")
    assert inspect([str(log), "-v"]) == 0
    said = capsys.readouterr().out
    assert "the log still proves what it claims" in said
    assert "a law that sets adjustable dampers" in said
