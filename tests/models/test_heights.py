"""Laws for study, which measure heights over the datum of a flat road: their loops, their norms, and where they are marked.

Each is held against equations in absolute coordinates, written down here: heights of body and wheels, with the road's height
under the tyres.
"""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models import Bump, parse_vehicle, read_vehicle
from models.roads.road import RoadInput
from sim.linear.sampled_response import continuous_response
from sim.runs.run import run_controllers
from synth.controller.implementation_norm import norm_as_implemented
from synth.controller.measured_heights import STUDY
from synth.controller.report import study_notes
from synth.vehicle.designer import Designer
from tests.support.commands import in_the_suite, main_of, prose, refused

ROWS = {"quarter_car": ("",), "half_car": ("_front", "_rear"),
        "full_car": ("_front_left", "_front_right", "_rear_left", "_rear_right")}  # fmt: skip
KINDS = ("sprung_displacement", "sprung_velocity", "unsprung_displacement", "unsprung_velocity")
GAINS = np.array([-4000.0, -1200.0, 1500.0, 80.0])  # N/m, N s/m
TIME, SPEED = np.arange(0, 0.8, 1e-3), 12.5  # until the rear wheels have met a bump


def studied(kind, gains=GAINS):
    """A shipped vehicle with a law u = gains [z_s, z_s', z_u, z_u'] of each corner."""
    measured = [f"{name}{ending}" for ending in ROWS[kind] for name in KINDS]
    K = np.kron(np.eye(len(ROWS[kind])), gains).tolist()
    section = f"[controllers.abs]\nstudy = true\nmeasured = {measured}\ngain = {K}\n".replace("'", '"')
    return parse_vehicle(f"{read_vehicle(kind).text}\n{section}")


def loop_of(vehicle, gains=GAINS):
    """A of the loop in [q, z_u, q', z_u'], the effect of the roads' heights, and the rows of heights, velocities and forces.

    It is M z'' = -K z - C z' + [S' u; -u] + [0; k_t z_r], with S the heights of the body over its corners per q.
    """
    p, ends = vehicle.parameters, ROWS[vehicle.kind.name]
    axles = [end.split("_")[1] if end else "" for end in ends]
    x = [p[f"axle_distance_{axle}"] * (1 if axle == "front" else -1) if axle else 0.0 for axle in axles]
    y = [p.get("track", 0.0) / 2 * (end.endswith("left") - end.endswith("right")) for end in ends]
    ks, cs, mu, kt = (np.array([p[f"{name}_{axle}".rstrip("_")] for axle in axles]) for name in (
        "suspension_stiffness", "suspension_damping", "unsprung_mass", "tyre_stiffness"))  # fmt: skip
    k, c = {1: 1, 2: 2, 4: 3}[len(ends)], len(ends)
    S, n = np.column_stack([np.ones(c), -np.array(x), y])[:, :k], k + c
    T = np.hstack([S, -np.eye(c)])
    M = np.diag([*[p["sprung_mass"], p.get("pitch_inertia", 0.0), p.get("roll_inertia", 0.0)][:k], *mu])
    K, C = T.T @ np.diag(ks) @ T + np.diag([*np.zeros(k), *kt]), T.T @ np.diag(cs) @ T
    over = np.vstack([np.hstack([S, np.zeros((c, c))]), np.eye(n)[k:]])
    heights, rates = np.hstack([over, np.zeros((2 * c, n))]), np.hstack([np.zeros((2 * c, n)), over])
    u = gains[0] * heights[:c] + gains[1] * rates[:c] + gains[2] * heights[c:] + gains[3] * rates[c:]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    A[n:] += np.linalg.solve(M, np.vstack([S.T, -np.eye(c)])) @ u
    return A, np.vstack([np.zeros((n + k, c)), np.diag(kt / mu)]), heights, rates, u


@pytest.mark.parametrize("kind", in_the_suite(["quarter_car"], ROWS))
def test_measured_heights_over_a_bump(kind):
    """The continuous response is that of equations in absolute coordinates, to 1e-9; 2 % of a gain shows. MuJoCo agrees."""
    vehicle = studied(kind)
    controller = Designer(vehicle).design("abs")
    late = np.array([wheel.behind(vehicle.parameters) / SPEED for wheel in vehicle.kind.wheels])

    def own(gains):
        A, E, heights, _, u = loop_of(vehicle, gains)

        def road(t):
            at = SPEED * (t - late)
            return np.where((at > 0) & (at < 5), 0.05 * (1 - np.cos(2 * np.pi * at / 5)), 0.0)

        found = solve_ivp(lambda t, s: A @ s + E @ road(t), (0, TIME[-1]), np.zeros(len(A)), "DOP853", TIME, rtol=1e-11,
                          atol=1e-13, max_step=2e-3)  # fmt: skip
        return {"sprung_displacement": heights[0] @ found.y, "control_force": u[0] @ found.y}

    response = continuous_response(controller, RoadInput(vehicle, Bump(speed=SPEED), TIME))
    right, wrong = own(GAINS), own(GAINS * [1.02, 1, 1, 1])
    for name, values in right.items():
        ours, peak = response[f"{name}{ROWS[kind][0]}"], np.abs(values).max()
        assert np.abs(ours - values).max() < 1e-8 * peak
        assert np.abs(ours - wrong[name]).max() > 1e-4 * peak
    for road in (Bump(height=1e-3, speed=SPEED), Bump(height=0.02, speed=SPEED)):
        assert run_controllers(vehicle, [controller], road, TIME)[0].agreement.agrees
    assert study_notes(vehicle, controller)[0] == STUDY


def test_norm_of_a_law_that_lets_no_lasting_height_show():
    """If z is the body's acceleration and the tyre, the norm from the road's velocity is finite: the peak in own coordinates."""
    vehicle = dataclasses.replace(studied("quarter_car"), performance={"sprung_acceleration": 1.0, "tyre_deflection": 10.0})
    controller = Designer(vehicle).design("abs")
    A, E, heights, rates, _ = loop_of(vehicle)
    peak = controller.certificate.norm.peak_frequency
    s = 1j * np.concatenate([np.geomspace(0.1, 400, 4000), peak * (1 + np.linspace(-1e-3, 1e-3, 201))])[:, None, None]
    x = np.linalg.solve(s * np.eye(4) - A, E) / s
    z = np.concatenate([s * (rates[:1] @ x), 10 * (heights[1:] @ x - 1 / s)], axis=1)
    assert controller.certificate.norm.value == pytest.approx(float(np.linalg.norm(z, axis=1).max()), rel=1e-7)
    assert controller.certificate.stable
    assert not controller.certificate.failures
    assert controller.certificate.gap is not None
    assert controller.certificate.gap > 0
    fast = dataclasses.replace(vehicle.implementation, sample_period=1e-4)
    built = norm_as_implemented(dataclasses.replace(vehicle, implementation=fast), controller)
    assert built.value == pytest.approx(controller.certificate.norm.value, rel=2e-3)
    assert built.reached == pytest.approx(built.value, rel=1e-6)


@pytest.mark.parametrize("numerator", [[1.0, 0.0], [1.0]])
def test_norm_with_a_filter_of_the_road(numerator):
    """A filter that is 0 at 0 rad/s bounds the road's height, and every z has a norm; another filter does not."""
    filtered = f"road = {{ numerator = {numerator}, denominator = [1.0, 2.0] }}"
    text = studied("quarter_car").text.replace("[performance]", f"[performance]\n{filtered}")
    controller = Designer(vehicle := parse_vehicle(text)).design("abs")
    A, E, heights, rates, u = loop_of(vehicle)
    if numerator == [1.0]:
        assert controller.certificate.stable
        assert math.isinf(controller.certificate.norm.value)
        assert study_notes(vehicle, controller)[1].endswith("causes a constant control_force, suspension_deflection")
        return
    s = 1j * np.geomspace(0.01, 400, 40001)[:, None, None]
    x = np.linalg.solve(s * np.eye(4) - A, E) / (s + 2)
    weights, p = vehicle.performance, np.diff(heights[::-1], axis=0)
    rows = {"sprung_acceleration": s * (rates[:1] @ x), "suspension_deflection": p @ x,
            "tyre_deflection": heights[1:] @ x - 1 / (s + 2), "control_force": u @ x}  # fmt: skip
    z = np.concatenate([weights[name] * row for name, row in rows.items()], axis=1)
    assert controller.certificate.norm.value == pytest.approx(float(np.linalg.norm(z, axis=1).max()), rel=1e-6)


def test_a_published_design_of_absolute_states():
    """State feedback that places the poles of a quarter-car at -22 +- 10i and -9 +- 7i [1/s] (a public MATLAB exercise).

    Its states are z_s, z_s', z_u, z_u', and its force is positive if it pulls body and wheel together: u = -K x of it is ours
    with +K. The gain follows from the poles by Ackermann's formula.
    """
    ms, mu, ks, cs, kt = 427.0, 40.0, 19960.0, 1050.0, 175500.0
    A, B = np.eye(4, k=1), np.array([0, -1 / ms, 0, 1 / mu])
    A[1], A[3] = np.array([-ks, -cs, ks, cs]) / ms, np.array([ks, cs, -ks - kt, -cs]) / mu
    A[2] = [0, 0, 0, 1]
    poles = np.array([-22 - 10j, -22 + 10j, -9 - 7j, -9 + 7j])
    reach = np.column_stack([np.linalg.matrix_power(A, i) @ B for i in range(4)])
    wanted = sum(a * np.linalg.matrix_power(A, 4 - i) for i, a in enumerate(np.poly(poles).real))
    K = np.linalg.solve(reach.T, [0, 0, 0, 1]) @ wanted
    values = {"sprung_mass": ms, "unsprung_mass": mu, "suspension_stiffness": ks, "suspension_damping": cs, "tyre_stiffness": kt}
    right, wrong = (
        Designer(studied("quarter_car", sign * K).with_parameters(**values)).design("abs").certificate for sign in (1, -1)
    )
    assert np.sort_complex(right.poles) == pytest.approx(poles, rel=1e-8)
    assert not wrong.stable


INTEGRAL = "{ numerator = [1.0], denominator = [1.0, 0.0] }"


@pytest.mark.parametrize(("old", "new", "said"), [
    ("study = true\n", "", "'sprung_displacement' is an absolute height .above the datum of a flat road., .* give study = true"),
    ('"sprung_displacement", "sprung_velocity", "unsprung', '"tyre_deflection", "sprung_velocity", "suspension_deflection"]#',
     "contains no absolute height .above the datum of a flat road., but study = true affects only such heights"),
    ("gain = ", 'order = "full"\n#', "only a given law may measure heights"),
    ("suspension_deflection = 0.1", f"suspension_deflection = {INTEGRAL}", "cannot return the integral to zero"),
])  # fmt: skip
def test_refused(old, new, said):
    """Heights need the key, the key needs heights, and neither designs nor integrals go with them: one line each."""
    with refused(match=said):
        Designer(parse_vehicle(studied("quarter_car").text.replace(old, new))).design("abs")


@pytest.mark.parametrize("command", [
    "synth", "sim.bump --no-logs", "synth --export code",
    "sim.drive --controller passive --controller I --controller II --controller state --no-logs --duration 0.1 --road step",
])  # fmt: skip
def test_marked(tmp_path, monkeypatch, capsys, command):
    """Tables of designs, runs of one and of many controllers, and exports say that a law for study is not realisable."""
    (tmp_path / "car.toml").write_text(studied("quarter_car").text)
    monkeypatch.chdir(tmp_path)
    name, *options = command.split(" ")
    main_of(name)([*options, "--vehicle", "car.toml", "--controller", "abs"])
    assert STUDY in prose(capsys.readouterr().out)
    if "code" in options:
        assert STUDY.capitalize()[1:] in (tmp_path / "code" / "README.md").read_text()
