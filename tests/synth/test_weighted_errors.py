"""Errors that are weighted by frequency: mu proved from above without the search, and shown from below by errors themselves."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.kinds.kind import HERE
from models.vehicle.vehicle import parse_vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable
from synth.design.uncertainty.structured_bound import NEAR, StructuredBound, best_scales, structured_bound
from synth.design.uncertainty.structured_loop import StructuredLoop
from synth.design.uncertainty.structured_perturbation import _all_pass, closed_by_errors, worst_errors
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from synth.vehicle.weighted_errors import structured_plant
from tests.support.shared import printed

MEETS = 1e-3  # relative: NEAR of it is the bound's distance from the scales' peak, the rest that of a frequency from the peak

WEIGHT = "{ weight = { numerator = [3.0, 18.516402], denominator = [1.0, 46.291005] } }"  # makeweight(0.40, 15, 3)
CAR = """type = "quarter_car"
[parameters]
sprung_mass = 300.0
unsprung_mass = 60.0
suspension_stiffness = 16000.0
suspension_damping = 1000.0
tyre_stiffness = 190000.0
[performance]
sprung_acceleration = 1.0
control_force = {{ weight = 1e-3, numerator = [1.0, 50.0], denominator = [1.0, 500.0] }}
[controllers.soft]
measured = ["suspension_deflection", "sprung_velocity"]
gain = [[2000.0, -1500.0]]
tolerance = {tolerance}
"""


def random_loop(seed: int, errors: int, performance: bool) -> StructuredLoop:
    """A stable loop with its units far apart, and now and then a feedthrough."""
    rng = np.random.default_rng(seed)
    n, (d, r) = int(rng.integers(2, 8)), rng.integers(1, 4, 2) if performance else (0, 0)
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.02, 0.2)) * np.eye(n)
    B = rng.standard_normal((n, r + errors)) * 10.0 ** rng.uniform(-3, 3, r + errors)
    C = rng.standard_normal((d + errors, n)) * 10.0 ** rng.uniform(-3, 3, (d + errors, 1))
    D = 0.1 * (seed % 3 == 0) * rng.standard_normal((d + errors, r + errors))
    return StructuredLoop(GeneralizedPlant(A, np.zeros((n, 0)), B, C, np.zeros((len(C), 0)), D), errors)


@pytest.mark.parametrize(("errors", "performance"), [(1, False), (2, False), (3, False), (1, True), (2, True)])
def test_up_to_three_blocks_the_bounds_meet(errors, performance):
    """The proved bound is never below what errors show, and meets it: with up to three blocks mu is what the best scales give."""
    for seed in range(2):
        loop = random_loop(100 * errors + seed, errors, performance)
        bound = structured_bound(loop)
        assert bound.holds(loop)
        found = worst_errors(loop, bound.peak_frequency)
        assert found.mu <= bound.gamma <= found.mu * (1 + MEETS)
        closed = closed_by_errors(loop, found.errors)
        assert all(abs(one.D[0, 0]) <= (1 + 1e-9) / found.mu for one in found.errors)  # an all-pass is as large at infinity
        assert closed is None or not is_stable(closed.A) or hinf_norm(closed).value >= found.mu * (1 - 1e-9)  # rounding


def test_what_is_proved_is_checked():
    """A bound lowered below the peak, a gap between its intervals, other scales and another loop are all refused."""
    loop = random_loop(203, 2, True)
    bound = structured_bound(loop)
    assert bound.holds(loop)
    lower = worst_errors(loop, bound.peak_frequency).mu
    assert not StructuredBound(lower * (1 - NEAR), bound.peak_frequency, bound.parts).holds(loop)
    first, *rest = bound.parts
    assert not replace(bound, parts=tuple(part._replace(D=900 * part.D) for part in bound.parts)).holds(loop)
    assert not replace(bound, parts=()).holds(loop)
    assert not replace(bound, parts=bound.parts[:-1]).holds(loop)
    assert not replace(bound, parts=(first._replace(low=1e-3), *rest)).holds(loop)
    faster = replace(loop, loop=replace(loop.loop, A=loop.loop.A + 10 * np.eye(len(loop.loop.A))))
    assert not bound.holds(faster)  # which is not stable


def test_a_car():
    """Of a gain on a car both robust claims hold in a range of 0.2 %, and the norm without errors is at most the second."""
    vehicle = parse_vehicle(CAR.format(tolerance=f"{{ force = {WEIGHT}, sprung_velocity = {{ weight = 0.1 }} }}"))
    controller = Designer(vehicle).design("soft")
    performance, stability = controller.robustness
    for promise in (performance, stability):
        assert promise.holds
        assert promise.proved is not None
        assert promise.value <= promise.proved <= promise.value * (1 + 2 * MEETS)  # four blocks at most
    assert stability.value < 1
    assert controller.certificate.norm.value <= performance.value
    errors = vehicle.controllers["soft"].errors
    assert errors is not None
    loop = structured_plant(vehicle, controller, errors).closed_by(controller.law)
    # A weight of one number is a gain, so the loop from its p to its q is known by hand: W K P / (1 - K P), at one frequency.
    model, omega = vehicle.linear_model, 7.0
    Cy, Dy = model.rows(controller.measured)
    P = Cy @ np.linalg.solve(1j * omega * np.eye(len(model.A)) - model.A, model.B) + Dy
    K, W = controller.gain, errors.weights["force"].response(np.array([omega]))[0]
    by_hand = W * (K @ P)[0, 0] / (1 - (K @ P)[0, 0])
    assert loop.at(np.array([omega]))[0, -2, -2] == pytest.approx(by_hand, rel=1e-9)


def test_z_weighs_the_requested_force():
    """The error of a force is in the acceleration that z weighs, and not in the force, with or without a lag, by itself or in a
    sum.
    """
    both = "both = { sum = { sprung_acceleration = 2.0, control_force = 0.5 } }\n[controllers.soft]"
    for lag in ("", "lag = true\n[limits]\nactuator_bandwidth = 60.0\n"):
        text = CAR.format(tolerance=f"{{ force = {WEIGHT} }}") + lag
        vehicle = parse_vehicle(text.replace("[controllers.soft]", both))
        controller = Designer(vehicle).design("soft")
        errors = vehicle.controllers["soft"].errors
        assert errors is not None
        open_loop = structured_plant(vehicle, controller, errors).closed_by(replace(controller.law, D=0 * controller.law.D))
        acceleration, force, summed, q = open_loop.at(np.array([7.0]))[0][:, -1]
        assert (force, q) == (0, 0)
        assert summed == pytest.approx(2 * acceleration, rel=1e-9)  # rounding
        through = 60 / (60 + 7j) if lag else 1.0
        B, (C, D) = vehicle.linear_model.B, vehicle.linear_model.rows(["sprung_acceleration"])
        A = vehicle.linear_model.A
        assert acceleration == pytest.approx(through * (C @ np.linalg.solve(7j * np.eye(len(A)) - A, B) + D)[0, 0], rel=1e-9)


def test_a_law_that_does_nothing():
    """Without a gain no error acts: mu for stability is 0, the loop bears all of them, and mu for performance is the norm."""
    vehicle = parse_vehicle(CAR.format(tolerance=f"{{ force = {WEIGHT} }}").replace("2000.0, -1500.0", "0.0, 0.0"))
    controller = Designer(vehicle).design("soft")
    performance, stability = controller.robustness
    assert (stability.value, stability.holds) == (0.0, True)
    assert performance.proved == pytest.approx(controller.certificate.norm.value, rel=MEETS)


def test_printed_saved_and_checked():
    """The table, `--json` and a saved file say the same, a file is proved anew, and one that asks too much fails."""
    text = CAR.format(tolerance=f"{{ force = {WEIGHT} }}").replace("gain = [[2000.0, -1500.0]]\n", "")
    files = {"car.toml": text}
    saved = printed("synth", "--vehicle", "car.toml", "--controller", "soft", "--json", "--save", "new.toml", files=files)
    (row,) = json.loads(saved.out)["controllers"]
    performance, stability = row["promises"]
    assert performance["promise"] == "robust performance (mu)"
    assert stability["at_most"] == 1.0
    new = (saved.folder / "new.toml").read_text()
    assert WEIGHT in new.split("soft_designed")[1]
    checked = printed("synth", "--check", "new.toml", "--json", files={"new.toml": new})
    assert checked.code == saved.code == 0
    assert json.loads(checked.out)["controllers"][0]["promises"] == row["promises"]
    asks_more = printed("synth", "--check", "new.toml", files={"new.toml": new.replace("[3.0, 18.516402]", "[60.0, 370.0]")})
    assert asks_more.code == 1
    assert "not met: robust stability (mu)" in asks_more.out


@pytest.mark.attack
def test_designed_for_its_errors():
    """Of full order the design comes below the printed 0.92 of MathWorks' car, and its certificate and promises hold."""
    text = (HERE / "gallery" / "mathworks" / "robust.toml").read_text()
    kept = [line for line in text.splitlines() if not re.match(r"[ABCD] = ", line)]
    controller = Designer(parse_vehicle("\n".join([*kept, 'order = "full"']))).design("K")
    performance, stability = controller.robustness
    assert performance.proved is not None
    assert controller.certificate.norm.value < performance.value <= performance.proved < 0.92
    assert stability.holds
    assert not controller.certificate.failures
    assert "designed for the smallest robust performance" in controller.remarks[0]


def test_no_sampled_error_does_more():
    """No random stable errors of the size that a bound allows make a loop unstable, or its norm larger than the bound."""
    rng = np.random.default_rng(7)
    for seed in range(2):
        loop = random_loop(900 + seed, 2, True)
        gamma = structured_bound(loop).gamma
        rate = np.abs(np.linalg.eigvals(loop.loop.A))
        worst = 0.0
        for _ in range(40):
            omega = rng.choice(rate) * 10 ** rng.uniform(-0.5, 0.5)
            closed = closed_by_errors(loop, [_all_pass(1 / gamma, angle, omega) for angle in rng.uniform(-np.pi, np.pi, 2)])
            assert closed is not None
            assert is_stable(closed.A)
            worst = max(worst, hinf_norm(closed).value)
        assert 0 < worst <= gamma


def test_of_the_continuous_loop():
    """Beside a sample period a line says that mu is of the continuous loop."""
    text = CAR.format(tolerance="{ force = { weight = 0.1 } }") + "[implementation]\nsample_period = 0.01\n"
    done = printed("synth", "--vehicle", "car.toml", "--controller", "soft", "-v", files={"car.toml": text})
    assert "robust stability and performance (mu) are those of the continuous loop" in " ".join(done.out.split())


def test_one_error_by_brute_force():
    """For one error and the performance, mu at a frequency is where the largest norm over all phases is its inverse size."""
    M = random_loop(102, 1, True).at(np.array([0.7]))[0]
    value, _ = best_scales(M, 1)
    phases = np.exp(1j * np.linspace(0, 2 * np.pi, 2001))
    zw, zp, qw, qp = M[:-1, :-1], M[:-1, -1:], M[-1:, :-1], M[-1, -1]

    def largest(size: float) -> float:
        return np.linalg.norm(zw + (zp @ qw) * (size * phases / (1 - size * phases * qp))[:, None, None], 2, axis=(1, 2)).max()

    low, high = 0.0, 1 / abs(qp)
    for _ in range(30):
        size = (low + high) / 2
        low, high = (size, high) if largest(size) * size < 1 else (low, size)
    assert value == pytest.approx(1 / low, rel=1e-5)  # of the grid of phases: (pi / 2000)^2 / 2 and less


def test_not_of_a_law_without_linear_claim():
    """A weight beside a semi-active law is refused, as there is no linear claim of it."""
    text = (HERE / "quarter_car_semi_active.toml").read_text()
    text += '[controllers.S]\nsemi_active = "skyhook"\ntolerance = { force = { weight = 0.1 } }\n'
    with pytest.raises(InputError, match="linear analysis does not apply"):
        parse_vehicle(text)


def test_the_loop_closed_by_errors_is_a_linear_fraction():
    """The response of a loop that errors close is M11 + M12 E (1 - M22 E)^-1 M21, feedthroughs included."""
    for seed in (3, 6):  # which have some
        loop = random_loop(seed, 2, True)
        assert loop.loop.Dw.all()
        errors = [_all_pass(0.1, angle, 2.0) for angle in (0.5, -2.0)]
        closed = closed_by_errors(loop, errors)
        assert closed is not None
        omega = np.array([0.0, 1.0, 30.0])
        for w, M, found in zip(omega, *(one.frequency_response(omega) for one in (loop.loop, closed)), strict=True):
            E = np.diag([(one.C @ np.linalg.solve(1j * w * np.eye(len(one.A)) - one.A, one.B) + one.D)[0, 0] for one in errors])
            whole = M[:-2, :-2] + M[:-2, -2:] @ E @ np.linalg.solve(np.eye(2) - M[-2:, -2:] @ E, M[-2:, :-2])
            assert np.allclose(found, whole, rtol=1e-8, atol=1e-10 * np.abs(whole).max())
