"""Hysteretic dampers whose voltage a controller sets: the choice of the voltage, whole runs, energy, samples and refusals."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import minimize_scalar

from models import Bump, InputError, parse_vehicle, read_vehicle
from models.parts.settable import SetElement
from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle
from sim import run
from sim.linear.dampers import closing_velocities
from sim.linear.stepped import stepped_runs
from sim.runs.sampled_vehicle import with_sample
from synth.controller.controller import Controller
from synth.vehicle.designer import driver_of
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks
from tests.support.mechanism import G

N = {"alpha": 4e3, "per": 2.4e4, "c0": 250.0, "c0_per": 150.0, "c1": 5e3, "c1_per": 2e3, "k0": 3e3, "k1": 400.0}
KINDS = {
    "bouc_wen": f"alpha = {N['alpha']}\nalpha_per_volt = {N['per']}\nc0 = {N['c0']}\nc0_per_volt = {N['c0_per']}\n"
    "beta = 40.0\ngamma = -10.0\nfriction = true",
    "modified_bouc_wen": f"alpha = {N['alpha']}\nalpha_per_volt = {N['per']}\nc0 = {N['c0']}\nc0_per_volt = {N['c0_per']}\n"
    f"c1 = {N['c1']}\nc1_per_volt = {N['c1_per']}\nk0 = {N['k0']}\nk1 = {N['k1']}\nA = 8.0\ngamma = 4e3\nbeta = 1e3",
    "dahl": "force = 60.0\nforce_per_volt = 500.0\ndamping = 250.0\ndamping_per_volt = 150.0\nrho = 200.0",
}
OF_FILE = "largest_voltage = 2.0\nvoltage = 0.25\n"
LAWS = '[controllers.sky]\nsemi_active = "skyhook_linear"\nsky_damping = 1800.0\n'
LAWS += '[controllers.gain]\nmeasured = ["sprung_velocity", "suspension_deflection"]\ngain = [[-1800.0, 4e3]]\n'
TIMED = "[implementation]\nsample_period = 0.004\n"
R = "[curves]\nmotion_ratio = { deflection = [-0.2, 0.2], ratio = [0.66, 0.74] }\n"  # 0.7 + d / (5 m)


@cache
def car(kind: str, more: str = OF_FILE, others: str = TIMED, laws: str = LAWS, type_: str = "quarter_car") -> Vehicle:
    text = read_vehicle(type_).text.partition("[controllers")[0]
    return parse_vehicle(f'{text}\n[parts.mr]\nkind = "{kind}"\n{KINDS[kind]}\n{more}\n{others}\n{laws}')


def inner(vehicle: Vehicle) -> SetElement:
    (part,) = (getattr(one.part, "part", one.part) for one in vehicle.parts if one.element)
    assert isinstance(part, SetElement)
    return part


@pytest.mark.parametrize("kind", KINDS)
def test_the_voltage_is_the_one_with_the_nearest_force(kind):
    """No voltage of a fine grid has a force nearer to a request, at motions and states of either sign."""
    part, rng = inner(car(kind)), np.random.default_rng(1)
    d, v, f = rng.normal(0, [[0.03], [0.3], [900.0]], (3, 500))
    z = rng.uniform(-1, 1, (500, len(part.states))) * (1.0 if kind == "dahl" else 0.03)
    f[:20] = 0.0
    found = part.setting(f, d, v, z)
    assert found.min() == part.low == -0.25
    assert found.max() == part.high == 1.75
    assert not found[:20].any(), "no request, no change"
    grid = np.linspace(-0.25, 1.75, 4001)[:, None]
    away, least = np.abs(part.push(d, v, z, found) - f), np.abs(part.push(d, v, z, grid) - f).min(axis=0)
    assert (away <= least + 1e-9).all()
    assert not part.setting(f, 0 * d, 0 * v, 0 * z).any(), "at rest, no voltage gives a force"


def pull_and_rates(u, D, w, z, factor=1.0):
    """Pull and rates of the modified Bouc-Wen model by Spencer's equations, with a factor on alpha per volt."""
    alpha, c0, c1 = N["alpha"] + factor * N["per"] * u, N["c0"] + N["c0_per"] * u, N["c1"] + N["c1_per"] * u
    speed = (alpha * z[1] + c0 * w + N["k0"] * (D - z[0])) / (c0 + c1)
    rest = w - speed
    return c1 * speed + N["k1"] * D, [speed, 8.0 * rest - 4e3 * abs(rest) * abs(z[1]) * z[1] - 1e3 * rest * z[1] ** 2]


def integrated(on: RoadInput, law: str, factor=1.0) -> np.ndarray:
    """Deflections of suspension and tyre, and voltage, over a run: the voltage by a search at each sample, then DOP853."""
    p, x, u, found = on.vehicle.parameters, np.zeros(6), 0.25, []
    for k in range(len(on.time)):
        (d, v), z = (x[0] - x[1], x[2] - x[3]), x[4:]
        r = 0.7 + d / 5
        D = 0.7 * d + d * d / 10
        if k % 2 == 0:
            still = pull_and_rates(0.25, D, r * v, z, factor)[0]
            if law == "gain":  # of the element's force beyond that without a command
                wanted = still + 1800.0 * x[2] - 4e3 * d
            else:  # of its whole force; 0 V where a damper to the sky pushes the other way
                wanted = 1800.0 * x[2] * r / 0.7**2 if x[2] * v > 0 else pull_and_rates(0.0, D, r * v, z, factor)[0]

            def away(u, D=D, w=r * v, z=z, wanted=wanted):
                return abs(pull_and_rates(u, D, w, z, factor)[0] - wanted)

            searched: Any = minimize_scalar(away, bounds=(0.0, 2.0), method="bounded", options={"xatol": 1e-10})
            u = min((0.25 if away(0.25) < 1e-9 else searched.x, 0.0, 2.0), key=away)
        found.append([d, x[1] - on.heights[k, 0], u])

        def rate(_, x, road=on.midway[k, 0], u=u):
            d, v = x[0] - x[1], x[2] - x[3]
            r = 0.7 + d / 5
            D = 0.7 * d + d * d / 10
            pull, rates = pull_and_rates(u, D, r * v, x[4:], factor)
            spring = p["suspension_stiffness"] * D + p["suspension_damping"] * r * v
            f = r * (spring + pull) - (r / 0.7 - 1) * p["sprung_mass"] * G
            return [x[2], x[3], -f / p["sprung_mass"], (f - p["tyre_stiffness"] * (x[1] - road)) / p["unsprung_mass"], *rates]

        x = solve_ivp(rate, (0.0, on.timestep), x, "DOP853", rtol=1e-8, atol=1e-11).y[:, -1]
    return np.array(found)


@pytest.mark.parametrize("law", ["sky", "gain"])
def test_a_run_is_an_independent_integration(law):
    """A modified Bouc-Wen damper on a rocker: motion and voltage are those of an own integration, where 2 % of a number show."""
    vehicle = car("modified_bouc_wen", others=TIMED + R)
    on = RoadInput(vehicle, Bump(0.06, 3.0, 12.5), np.arange(150) * 2e-3)
    physics = simulate([driver_of(vehicle, law)], [on]).run(0)
    found = np.stack([physics[name] for name in ("suspension_deflection", "tyre_deflection", "voltage")], axis=-1)
    right, wrong = (np.std((found - integrated(on, law, factor))[2:], axis=0) / found.std(axis=0) for factor in (1.0, 1.02))
    assert right[:2].max() < 1e-4
    assert right[2] < 3e-3, "more sensitive, as a suspension turns"
    assert wrong.max() > 1e-2


# The loss of a Bouc-Wen element with a set voltage is also in the next test.
@pytest.mark.parametrize(
    ("kind", "more"),
    [("modified_bouc_wen", f"{OF_FILE}bandwidth = 120.0\n"), *attacks([("dahl", OF_FILE), ("bouc_wen", OF_FILE)])],
)
def test_the_nonlinear_response_and_the_verdict_are_those_of_mujoco(kind, more):
    """On a quarter-car through a rocker the gain's nonlinear response is MuJoCo's run; the run passes, and takes energy."""
    vehicle = car(kind, more, f"{TIMED[:-1]}\ndelay = 1.0\n{R}")
    on, gain = RoadInput(vehicle, Bump(0.03, 3.0, 12.5), np.arange(80) * 2e-3), driver_of(vehicle, "gain")
    assert isinstance(gain, Controller)
    (found,) = stepped_runs([gain], [on]).response.values
    physics = simulate([gain], [on]).run(0)
    scale = np.abs(physics.values).max(axis=0)
    assert (np.abs(found - physics.values).max(axis=0) < 1e-9 * np.where(scale, scale, 1.0)).all()
    assert len(closing_velocities(vehicle, physics)[0]) == 2 + len(vehicle.kind.of_parts)
    [one] = run(vehicle, "sky", Bump(0.05, 2.0, 12.5), 0.2)
    assert one.passed
    assert one.energy is not None
    assert one.energy.least is not None
    assert one.energy.least > -1e-9


def test_the_coil_works_as_the_stored_energy_changes_with_the_voltage():
    """The work of the actuator is alpha per volt times S(z) and the change of the voltage, at each sample."""
    vehicle = car("bouc_wen", others=TIMED)
    [one] = run(vehicle, "gain", Bump(0.05, 2.0, 12.5), 0.3)
    u, z = one.physics["voltage"], one.physics["mr_hysteresis"]
    returned = [quad(lambda x: x / (1 + 50 * x), 0.0, abs(x))[0] for x in z]
    coil = N["per"] * np.sum(np.diff(u) * returned[1:])
    assert one.energy is not None
    assert one.energy.actuators == pytest.approx(coil, rel=1e-9)
    assert abs(coil) > 0.01 * one.energy.dissipated


def test_linear_analysis_and_passive_have_the_voltage_without_a_command():
    """Linear model and passive run are those of the constant voltage; a controller that pushes leaves the element there."""
    vehicle, constant = car("dahl"), car("dahl", "voltage = 0.25\n", TIMED, "")
    assert np.array_equal(vehicle.linear_model.A, constant.linear_model.A)
    [one], [other] = (run(each, "passive", Bump(0.05, 2.0, 12.5), 0.2) for each in (vehicle, constant))
    names = [name for name in other.physics.names]
    assert all(np.array_equal(one.physics[name], other.physics[name]) for name in names)
    assert set(one.physics["voltage"]) == {0.25}
    pushed = vehicle.with_force_actuators
    assert not pushed.dampers
    assert "voltage" not in [signal.name for signal in pushed.kind.signals]


def test_a_campaign_samples_the_numbers_of_the_damper():
    """A sampled vehicle has the limits of its own numbers, and runs beside others as alone."""
    laws = LAWS.partition("[controllers.gain")[0] + "[controllers.gain]\n"
    laws += 'measured = ["heave_velocity", "suspension_deflection_front"]\ngain = [[-900.0, 4e3], [-900.0, 0.0]]\n'
    vehicle = car("dahl", f"{OF_FILE}bandwidth = 120.0\n", TIMED, laws, "half_car")
    sample = {"mr.largest_voltage": 1.5, "mr.bandwidth": 60.0, "mr.force_per_volt": 700.0, "mr.voltage": 0.0}
    other = with_sample(vehicle, sample)
    assert [(one.low, one.high, one.damper.bandwidth) for one in other.parts.adjustable] == [(0.0, 1.5, 60.0)] * 2
    inputs = [RoadInput(one, Bump(0.05, 2.0, 12.5), np.arange(60) * 2e-3) for one in (vehicle, other, vehicle)]
    for name in ("sky", "gain"):
        controllers = [driver_of(one.vehicle, name) for one in inputs]
        together = simulate(controllers, inputs).response.values
        for values, controller, on in zip(together[:2], controllers, inputs, strict=False):
            assert np.array_equal(values, simulate([controller], [on]).response.values[0])


@pytest.mark.parametrize(
    ("more", "others", "said"),
    [
        (OF_FILE, '[actuators]\nkind = "force"', "largest_voltage and [actuators] both control control_force"),
        (OF_FILE, '[actuators]\nkind = "damper"\nc_min = 100\nc_max = 900', "omit one of the two"),
        (OF_FILE, "[limits]\nactuator_force = 900", "actuator_force applies only to force actuators, but [parts.mr]"),
        (
            OF_FILE,
            f'[parts.b]\nkind = "dahl"\n{KINDS["dahl"]}\n{OF_FILE}',
            "both control control_force, but only one element can; omit",
        ),
        ("largest_voltage = 2.0\nvoltage = 3.0", "", "voltage = 3 V, which applies while the controller gives no com"),
        ("bandwidth = 9.0", "", "bandwidth has no effect, because the voltage is constant"),
        (
            OF_FILE,
            '[controllers.f]\nmeasured = ["control_force"]\ngain = [[0.1]]',
            "but no sensor measures the force of a damper of [parts]",
        ),
    ],
)
def test_what_cannot_be_set_is_refused_in_a_line(more, others, said):
    with pytest.raises(InputError) as error:
        car("dahl", more, others)
    assert said in str(error.value)
    assert "\n" not in str(error.value)
