"""Step metrics are located between samples: against closed forms, and an own solution by matrix exponentials and Brent."""

import functools
import itertools
import json
import math
from typing import Any

import numpy as np
import pytest
from scipy import integrate, linalg, optimize

from models.common.errors import InputError
from models.kinds.kind import GRAVITY
from models.roads.obstacles import Step
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.drive.__main__ import main
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.between_samples import DEGREE, Pieces, exact
from sim.studies.ride.step_response import NEVER_OUTSIDE, NOT_SETTLED, SETTLED, measure_step, step_metrics
from synth.vehicle.designer import Designer
from tests.models.test_python_laws import GAIN, vehicle_of
from tests.models.test_semi_active_dampers import DAMPER
from tests.support.commands import attacks, prose
from tests.support.shared import ran

ROAD, DURATION, STEP = Step(height=0.005, edge=0.2, speed=8.0), 2.0, 1e-3


def pieces_of(function, end, step):
    """Returns a function of time as pieces."""
    start = np.arange(round(end / step)) * step
    return Pieces(start, np.full(len(start), step), function(start[:, None] + np.linspace(0, step, DEGREE + 1)))


def size(function, edges):
    """Returns the integrals of the size of a function and of its product with time, between the edges."""
    spans = [*itertools.pairwise(edges)]
    plain = sum(integrate.quad(lambda t: abs(function(t)), *span, epsabs=1e-15, epsrel=1e-12)[0] for span in spans)
    timed = sum(integrate.quad(lambda t: t * abs(function(t)), *span, epsabs=1e-15, epsrel=1e-12)[0] for span in spans)
    return plain, timed


def test_an_edge_within_a_step():
    """An edge of 50 us is a blow on a wheel whose tyre damps: its acceleration peaks within the first step of 1 ms.

    The own grid finds the peak to 1e-8, and its time to 5e-5; one polynomial of the whole step has less than 1 % of it.
    """
    text = read_vehicle("quarter_car").text.replace(
        "[performance]", "tyre_damping = 1500.0\n[performance]\nunsprung_acceleration = 0.1"
    )
    vehicle, road = parse_vehicle(text), Step(height=0.01, edge=1e-3, speed=20.0)
    model, end = vehicle.linear_model, 1e-3 / 20.0
    run = run_controllers(vehicle, [Designer(vehicle).design("passive")], road, sample_times(vehicle, 0.5, STEP))[0]

    def velocity(t):
        return 0.005 * math.pi / end * np.sin(math.pi * t / end)

    solution = integrate.solve_ivp(lambda t, x: model.A @ x + model.Bw[:, 0] * velocity(t), (0, end), np.zeros(4), "DOP853",
                                   t_eval=np.linspace(0, end, 20_001), rtol=1e-11, atol=1e-14)  # fmt: skip
    i = model.outputs.index("unsprung_acceleration")
    own = model.C[i] @ solution.y + model.Dw[i, 0] * velocity(solution.t)
    found = measure_step(run)["unsprung_acceleration"].continuous
    assert found is not None
    assert (found.peak, found.peak_time) == pytest.approx((own.max(), solution.t[own.argmax()]), rel=1e-4)


@pytest.mark.parametrize("height", [0.2, -0.2])
def test_second_order(height):
    """A lightly damped step has the overshoot, time of the peak, settling time and integrals of the textbook."""
    zeta, omega, end = 0.2, 9.0, 4.0
    damped, angle = omega * math.sqrt(1 - zeta**2), math.acos(zeta)

    def error(t):
        return -height * np.exp(-zeta * omega * t) * np.sin(damped * t + angle) / math.sin(angle)

    metrics = step_metrics(pieces_of(lambda t: height + error(t), end, 0.01), height, True, 0.02 * abs(height))
    over = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    assert metrics.overshoot == pytest.approx(over, rel=1e-10)  # degree 8 at 0.09 rad a step
    assert metrics.peak == pytest.approx(height * (1 + over), rel=1e-11)
    assert metrics.peak_time == pytest.approx(math.pi / damped, rel=1e-8)
    last = max(roots(lambda t: abs(error(t)) - 0.02 * abs(height), np.arange(0, end, 1e-3)))
    assert metrics.settled == SETTLED
    assert metrics.settling_time == pytest.approx(last, abs=1e-10)
    zeros = [0.0, *((k * math.pi - angle) / damped for k in range(1, 20) if (k * math.pi - angle) / damped < end), end]
    assert (metrics.iae, metrics.itae) == pytest.approx(size(error, zeros), rel=1e-9)


def test_words():
    """A signal that ends outside the band, or is never outside, has a word and no number; one that never overshoots has 0."""
    slow = pieces_of(lambda t: 1 - np.exp(-t), 2.0, 0.01)
    metrics = step_metrics(slow, 1.0, True, 0.02)
    assert (metrics.settled, metrics.settling_time, metrics.overshoot) == (NOT_SETTLED, None, 0.0)
    metrics = step_metrics(slow, 1.0, True, 1.5)
    assert (metrics.settled, metrics.settling_time) == (NEVER_OUTSIDE, None)
    assert step_metrics(slow, 1.0, True, 0.2).settling_time == pytest.approx(math.log(5), abs=1e-10)


def test_a_touch_between_samples():
    """An extremum that leaves the band only between two samples is seen."""
    coarse = pieces_of(lambda t: np.exp(-0.2 * t) * np.cos(3 * t), 3.0, 0.5)
    at = math.pi / 3 - math.atan(0.2 / 3) / 3
    top = math.exp(-0.2 * at) * abs(math.cos(3 * at))
    band = top * (1 - 1e-5)
    last = step_metrics(coarse, 0.0, False, band).settling_time
    assert last == pytest.approx(
        optimize.brentq(lambda t: math.exp(-0.2 * t) * abs(math.cos(3 * t)) - band, at, at + 0.1), abs=1e-6
    )


def own(vehicle, gain, signal):
    """Returns the response of a signal of the quarter-car to `ROAD` at any time, by matrix exponentials.

    The road is part of the state: [z_s, z_s', z_u, z_u', z_r, sin, cos].
    """
    p = vehicle.parameters
    ms, mu, k, c, kt = (
        p[name] for name in ("sprung_mass", "unsprung_mass", "suspension_stiffness", "suspension_damping", "tyre_stiffness")
    )
    omega, until = math.pi / ROAD.duration, ROAD.duration
    force = np.zeros(7)
    for name, value in gain.items():
        row = {"suspension_deflection": [1, 0, -1, 0, 0, 0, 0], "sprung_velocity": [0, 1, 0, 0, 0, 0, 0]}[name]
        force += value * np.array(row, dtype=float)
    strut = np.array([-k, -c, k, c, 0, 0, 0]) + force
    moves = np.zeros((7, 7))
    moves[0, 1] = moves[2, 3] = 1.0
    moves[1] = strut / ms
    moves[3] = (-strut + np.array([0, 0, -kt, 0, kt, 0, 0])) / mu
    level = moves.copy()
    moves[4, 5] = ROAD.height * omega / 2
    moves[5, 6], moves[6, 5] = omega, -omega
    rows = {
        "suspension_deflection": np.array([1.0, 0, -1, 0, 0, 0, 0]),
        "tyre_deflection": np.array([0.0, 0, 1, 0, -1, 0, 0]),
        "sprung_acceleration": moves[1],
        "control_force": force,
    }
    start = np.eye(7)[6]
    edge = linalg.expm(moves * until) @ start

    @functools.cache
    def state(t):
        return linalg.expm(moves * t) @ start if t <= until else linalg.expm(level * (t - until)) @ edge

    def value(t):
        return float(rows[signal] @ state(t))

    def slope(t):
        return float(rows[signal] @ (moves if t <= until else level) @ state(t))

    return value, slope


@pytest.mark.parametrize(("kind", "start"), [("quarter_car", 0.0), ("half_car", 0.1)])
def test_a_vertical_edge(kind, start):
    """A vertical edge leaves what an impulse of the road's velocity leaves, under every wheel when it comes there.

    The continuous response is a sum of matrix exponentials, from the instant of each edge on, also where a run begins; MuJoCo
    agrees with the sampled response to its own error, tyres that damp included.
    """
    vehicle = read_vehicle(kind)
    damping = {one.name: 300.0 for one in vehicle.kind.parameters if one.name.startswith("tyre_damping")}
    vehicle, height = vehicle.with_parameters(**damping), 0.004
    (run,) = ran(vehicle, "passive", road=Step(height=height, edge=0.0, speed=10.0, start=start), duration=0.6)
    assert run.passed
    model, time = vehicle.linear_model, np.arange(0.0137, 0.6, 0.0137)
    later = [start + wheel.behind(vehicle.parameters) / 10.0 for wheel in vehicle.kind.wheels]
    states = np.zeros((len(time), len(model.A)))
    for i, at in enumerate(later):
        states += np.array([linalg.expm(model.A * max(t - at, 0.0)) @ model.Bw[:, i] * height * (t > at) for t in time])
    far = np.ones(len(time), dtype=bool)
    for at in later[1:]:  # within the step of 1 ms of a later edge a polynomial goes through both sides
        far &= np.abs(time - at) > 2e-3
    names = [name for name in model.outputs if not model.Dw[model.outputs.index(name)].any()]
    between = exact(run, tuple(names))
    for name in names:
        i = model.outputs.index(name)
        raised = np.stack([height * (time > at) for at in later], axis=-1)
        expected = states @ model.C[i] + raised @ model.Cr[i]
        assert between[name].at(time)[far] == pytest.approx(expected[far], abs=1e-9 * np.abs(expected).max()), name


def test_a_step_that_begins_later():
    """Metrics of a step count from its edge on, so that a run that begins earlier has the same to rounding."""
    vehicle = read_vehicle("quarter_car")
    metrics = []
    for start in (0.0, 0.25):
        (run,) = ran(vehicle, "I", road=Step(height=0.004, edge=0.08, speed=8.0, start=start), duration=1.0 + start)
        metrics.append(measure_step(run, 60.0)["suspension_deflection"].continuous)
    first, later = (dict(vars(one)) for one in metrics)
    assert first.pop("settled") == later.pop("settled")
    assert later == pytest.approx(first, rel=1e-9)


def roots(function, grid):
    """Returns the zeros of a function by Brent between the points of a grid."""
    values = np.array([function(t) for t in grid])
    return [
        optimize.brentq(function, grid[k], grid[k + 1], xtol=1e-15)
        for k in np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))
    ]


@pytest.mark.parametrize("name", ["passive", *attacks(["I"])])
def test_of_a_run(name):
    """Metrics of the continuous response are those of an own solution; MuJoCo's tend to them with the step."""
    vehicle = read_vehicle("quarter_car")
    (run,) = ran(vehicle, name, road=ROAD, duration=DURATION, timestep=STEP)
    metrics: Any = measure_step(run, 5.0)
    (again,) = ran(vehicle, name, road=ROAD, duration=DURATION, timestep=STEP / 2)
    finer: Any = measure_step(again, 5.0)
    controller: Any = run.controller
    gain = dict(zip(controller.measured, controller.law.D[0], strict=True)) if name != "passive" else {}
    grid = np.arange(0, DURATION + 1e-9, 2.5e-3)
    for signal in ("suspension_deflection", "tyre_deflection", "sprung_acceleration", *(["control_force"] if gain else [])):
        value, slope = own(vehicle, gain, signal)
        one = metrics[signal].continuous
        extrema = roots(slope, grid)
        top = max(extrema, key=lambda t: abs(value(t)))
        assert one.peak == pytest.approx(value(top), rel=1e-9)
        assert one.peak_time == pytest.approx(top, abs=1e-8)  # flat there: the root of the error of the value
        opposite = [-value(t) / value(top) for t in extrema if t > top]
        assert one.overshoot == pytest.approx(max(0.0, *opposite), rel=1e-8)
        band = 0.05 * abs(value(top))
        crossings = roots(lambda t, of=value, band=band: abs(of(t)) - band, grid)
        if abs(value(DURATION)) > band:
            assert one.settled == NOT_SETTLED
        else:
            assert one.settling_time == pytest.approx(max(crossings), abs=1e-9)
        assert (one.iae, one.itae) == pytest.approx(size(value, [0.0, ROAD.duration, *roots(value, grid), DURATION]), rel=1e-7)
        for key in ("iae", "itae", *([] if signal == "control_force" else ["peak"])):  # a staircase has its peak at a sample
            fine, coarse, true = (getattr(each, key) for each in (finer[signal].mujoco, metrics[signal].mujoco, one))
            if gain:  # a held force acts half a step late: the first power of the step
                assert (coarse - true) / (fine - true) == pytest.approx(2, rel=0.1)
            else:  # the road at its height midway: the second
                assert coarse == pytest.approx(true, rel=1e-3)
        assert metrics[signal].mujoco.peak == pytest.approx(metrics[signal].sampled.peak, rel=1e-6)  # RK4, small and on the road


def test_of_a_law_in_python(tmp_path):
    """The exact response to a law's held forces is MuJoCo's to the second power of the step, and a held force is a staircase."""
    vehicle = read_vehicle(vehicle_of(tmp_path, GAIN))
    law = vehicle.controllers["mine"].driver()
    (run,) = run_controllers(vehicle, [law], ROAD, sample_times(vehicle, 1.0, STEP))
    metrics: Any = measure_step(run)
    for name, one in metrics.items():
        for key in ("peak", "iae", "itae") if name != "sprung_acceleration" else ():
            assert getattr(one.continuous, key) == pytest.approx(getattr(one.mujoco, key), rel=1e-3)
    # A held force leaves a sawtooth in the acceleration, whose value before the next sample no sample has.
    jumps = np.diff(run.prediction.requested_force[:, 0]) / vehicle.parameters["sprung_mass"]
    before = run.continuous["sprung_acceleration"][1:] - jumps
    assert abs(metrics["sprung_acceleration"].continuous.peak) == pytest.approx(np.abs(before).max(), rel=1e-9)
    assert np.abs(before).max() > 1.02 * np.abs(run.continuous["sprung_acceleration"]).max()
    force = run.prediction.requested_force[:-1, 0]
    assert metrics["control_force"].continuous.iae == pytest.approx(np.abs(force).sum() * STEP, rel=1e-9)
    assert abs(metrics["control_force"].continuous.peak) == pytest.approx(np.abs(force).max(), rel=1e-12)


@pytest.mark.parametrize("gain", [-6000.0, 60e3])
def test_of_a_law_for_study(gain):
    """With a law that measures heights each signal ends where MuJoCo's run ends; an unstable loop has no such end."""
    law = f'[controllers.s]\nstudy = true\nmeasured = ["sprung_displacement", "sprung_velocity"]\ngain = [[{gain}, -3000.0]]\n'
    vehicle = parse_vehicle(f"{read_vehicle('quarter_car').text}\n{law}")
    time = sample_times(vehicle, 5.0 if gain < 0 else 0.5, STEP)
    run = run_controllers(vehicle, [Designer(vehicle).design("s")], ROAD, time)[0]
    metrics, stiffness = measure_step(run), vehicle.parameters["suspension_stiffness"]
    lasting = ROAD.height * stiffness / (stiffness - gain) if gain < 0 else ROAD.height  # k (z_r - z_s) + gain z_s = 0
    assert metrics["sprung_displacement"].final == pytest.approx(lasting, rel=1e-9)
    if gain > 0:
        assert metrics["control_force"].final == 0.0
        return
    for name, one in metrics.items():
        assert run.physics[name][-1] == pytest.approx(one.final, abs=2e-3 * np.abs(run.physics[name]).max()), name  # after 5 s
        assert one.mujoco is not None
        if one.final:
            largest = (np.sign(one.final) * run.physics[name]).max()
            assert one.mujoco.overshoot == pytest.approx(largest / abs(one.final) - 1, rel=1e-3, abs=1e-3)


def test_command(capsys):
    """The command prints what is in its JSON, the band is an option, and of other roads there is no band."""
    options = ["--controller", "I", "--road", "step:height=0.005", "--duration", "1", "--no-logs", "--band", "5"]
    assert main([*options, "--json"]) == 0
    step = json.loads(capsys.readouterr().out)["step"]
    assert step["band"] == 5.0
    (one,) = step["runs"]
    assert main([*options, "-v"]) == 0
    printed = prose(capsys.readouterr().out)
    travel = one["signals"]["suspension_deflection"]["mujoco"]
    assert f" I {travel['peak']:.5g} {travel['peak_time']:.5g} " in printed
    for name in ("suspension_deflection", "tyre_deflection", "sprung_acceleration", "control_force"):
        assert one["signals"][name]["final"] == 0.0
        assert f"{one['signals'][name]['continuous']['peak']:.5g}" in printed
    for road, band, said in (("bump", "5", "applies only to the response to a step"), ("step", "200", "200 % is not allowed")):
        with pytest.raises(InputError, match=f"--band {said}"):
            main(["--controller", "I", "--road", road, "--band", band])


@pytest.mark.parametrize("start", [0.0, 0.1002, 0.1007], ids=["at a sample", "early in a step", "late in a step"])
def test_tables_have_the_peak_at_a_vertical_edge(start):
    """Just behind a vertical edge the tyre has its height, and the wheel k_t height / m_u: in peaks and step metrics alike.

    Down such an edge the tyre leaves the road: MuJoCo's wheel then falls by its weight and the spring's force alone.
    """
    paper = read_vehicle("quarter_car")
    vehicle = parse_vehicle(paper.text.replace("[performance]", "[performance]\nunsprung_acceleration = 1.0"), source="wheel")
    p, passive, time = vehicle.parameters, [Designer(vehicle).design("passive")], sample_times(vehicle, 0.4, STEP)
    [up], [down] = (run_controllers(vehicle, passive, Step(height, edge=0.0, start=start), time) for height in (0.05, -0.05))
    metrics = measure_step(up)
    for name, right in (("tyre_deflection", 0.05), ("unsprung_acceleration", p["tyre_stiffness"] * 0.05 / p["unsprung_mass"])):
        routes = (metrics[name].mujoco, metrics[name].sampled, metrics[name].continuous)
        peaks = [abs(one.peak) for one in routes if one is not None]
        peaks += [float(one.peak(name)) for one in (up.physics, up.sampled, up.continuous)]
        assert peaks == pytest.approx([right] * 6, rel=1e-8)  # cubics: O(h^4), measured 2e-9
    falls = GRAVITY * (p["sprung_mass"] + p["unsprung_mass"]) / p["unsprung_mass"]
    sides = np.stack([down.physics["unsprung_acceleration"], down.physics.before["unsprung_acceleration"]])
    at = int(np.abs(np.diff(sides, axis=0)).argmax())
    assert sorted(sides[:, at]) == pytest.approx([-falls, 0.0], rel=1e-9, abs=1e-9)


def decided(vehicle, system_of, steps, height, time):
    """Accelerations of body and wheel just behind a vertical edge at 0 s, and on both sides of every tenth of a step, (K, 2).

    Args:
        system_of: function of a state; returns the A of the next `steps` steps, whose last state is the force, and that force.
    """
    model, h, found = vehicle.linear_model, time[1] / 10, []
    rows = [model.states.index(name) for name in ("sprung_velocity", "unsprung_velocity")]
    x, edge = np.zeros(4), model.Bw[:, 0] * height
    for k in range(0, len(time) - 1, steps):
        A, force = system_of(x)
        x, edge = x + edge, np.zeros(4)
        matrix, state = linalg.expm(A * h), np.append(x, force)
        for _ in range(10 * min(steps, len(time) - 1 - k)):
            found.append(A[rows] @ state)
            state = matrix @ state
            found.append(A[rows] @ state)
        x = state[:4]
    return np.array(found)


@pytest.mark.parametrize(("law", "steps"), [("I", 10), ("sky", 5), *attacks([("I", 4), ("sky", 1)])])
def test_tables_have_the_peak_at_a_decision(law, steps):
    """Where force or coefficient is held, both sides of a decision count, and cubics end there: both tables have one peak.

    It is that of the continuous signal, by matrix exponentials from decision to decision.
    """
    hold = f"\n[implementation]\nsample_period = {steps * STEP}\n" if steps > 1 else ""
    text = read_vehicle("quarter_car").text.replace("[performance]", "[performance]\nunsprung_acceleration = 1.0")
    damped = text.replace("[controllers", '[controllers.sky]\nsemi_active = "skyhook"\n[controllers', 1) + DAMPER
    vehicle = parse_vehicle((damped if law == "sky" else text) + hold, source="wheel")
    model, c = vehicle.linear_model, vehicle.parameters["suspension_damping"]
    nominal = parse_vehicle(damped if law == "sky" else text, source="wheel")  # one design for all periods
    driver, time = vehicle.driver(law, Designer(nominal).design), sample_times(vehicle, 0.2, STEP)

    def system_of(x):
        states = dict(zip(model.states, x, strict=True))
        body, stretching = states["sprung_velocity"], states["sprung_velocity"] - states["unsprung_velocity"]
        A, force = np.zeros((5, 5)), 0.0
        A[:4] = np.hstack([model.A, model.B])
        if law == "I":
            gain: Any = driver.law
            force = float((gain.D @ [states[name] for name in driver.measured])[0])
        else:  # the damper's force beside that of the constant one
            A[:4, :4] += model.B @ [[0.0, 0.0, c - (c_max := 4000.0 if body * stretching > 0 else 300.0), c_max - c]]
        return A, force

    [run] = run_controllers(vehicle, [driver], Step(0.01, edge=0.0), time)
    metrics = measure_step(run)
    peaks = np.abs(decided(vehicle, system_of, steps, 0.01, time)).max(axis=0)
    for name, peak in zip(("sprung_acceleration", "unsprung_acceleration"), peaks, strict=True):
        of_step = metrics[name].mujoco
        assert of_step is not None
        found = [run.physics.peak(name), abs(of_step.peak)]
        assert found == pytest.approx([peak] * 2, rel=1e-3), name
