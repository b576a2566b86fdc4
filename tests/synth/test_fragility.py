"""The errors of readings and forces that a law bears, proved below and found above; and laws rounded to what computers hold."""

import json
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.linear import LinearLaw, static_law
from models.vehicle.controllers import DesignConditions
from models.vehicle.vehicle import Vehicle, read_vehicle
from synth.__main__ import main
from synth.analysis.uncertainty_box import ScaledGain
from synth.controller.problem import problem
from synth.design.uncertainty.fragility import SHARES, fragility, proved_text, round_law
from synth.design.uncertainty.problem import scaled_gain
from synth.design.uncertainty.worst_case import norm_at
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer

NEAR = 1e-6  # relative; a little beyond the errors that were found to do more, and a little within
STEPS = 13  # of brute force along each reading's errors


def _gain(vehicle: Vehicle, controller: str):
    designer = Designer(vehicle)
    one = designer.design(controller)
    problem = designer.problem(one.measured)
    return scaled_gain(problem.plant, one.law)


def test_printed_controller_i_dies_where_it_cancels_the_spring():
    """Its deflection gain, 21.03 % too large, cancels the spring of 13100 N/m, whatever the other reading does."""
    found = fragility(_gain(read_vehicle("quarter_car"), "I_printed"))
    assert found.stable.smallest_violation == pytest.approx(
        13100 / 10824 - 1, rel=1e-8
    )  # eigenvalues near 0 have half the digits
    assert (
        0.998 * found.stable.smallest_violation < found.stable.proved_margin < found.stable.smallest_violation
    )  # asked for: a thousandth; it is proved there
    assert found.stable.readings[0] == found.stable.smallest_violation
    assert found.norm == pytest.approx(7.843188, abs=5e-7)  # by SLICOT
    assert (
        found.within[0.01].proved_margin
        <= found.within[0.01].smallest_violation
        < found.within[0.1].smallest_violation
        < found.stable.smallest_violation
    )


def test_the_skyhook_bears_a_reading_that_is_missing():
    """II only damps: without its force the car is stable, too, so no error up to 100 % makes it unstable, and that is proved."""
    found = fragility(_gain(read_vehicle("quarter_car"), "II_printed"))
    assert np.isinf(found.stable.smallest_violation)
    assert found.stable.proved_margin == 1.0
    assert found.stable.readings == pytest.approx([-1.0])  # no control force is the worst of all
    assert found.within[0.1].smallest_violation < 1


def test_a_force_that_is_measured_is_one_more_reading(paper):
    """A law told its own force, u = -4000 v + 0.1 u, has the norm of u = -4444 v; missing, that reading costs a tenth of it."""
    (plant_problem, one), (_, plain) = (
        (problem(paper, measured, DesignConditions()), static_law(np.array([gain])))
        for measured, gain in ((("sprung_velocity", "control_force"), [-4000.0, 0.1]), (("sprung_velocity",), [-4000.0 / 0.9]))
    )
    gain = scaled_gain(plant_problem.plant, one)
    alone = scaled_gain(plant_problem.plant.rows([0]), plain)
    found, plainly = fragility(gain), fragility(alone)
    assert found.norm == pytest.approx(plainly.norm, rel=1e-9)
    assert np.isinf(found.stable.smallest_violation)
    assert found.stable.proved_margin == plainly.stable.proved_margin == 1.0
    silent = plant_problem.plant.rows([0, 1, 1])
    silent = replace(silent, Cy=silent.Cy * [[1], [1], [0]], Dyu=silent.Dyu * [[1], [1], [0]], Dyw=None)
    with pytest.raises(
        InputError, match=r"row 2 of \[Cy Dyu\] is zero: the signal contains no information on the state or force; omit the row"
    ):
        scaled_gain(silent, static_law(np.ones((1, 3))))


def _random(seed: int):
    """A stable loop of a random plant of two readings, in odd units."""
    generator = np.random.default_rng(seed)
    n, m = int(generator.integers(2, 5)), 1 + seed % 2
    A, B, Cy = generator.standard_normal((n, n)), generator.standard_normal((n, m)), generator.standard_normal((2, n))
    K = generator.standard_normal((m, 2))
    A -= (np.linalg.eigvals(A + B @ K @ Cy).real.max() + generator.uniform(0.02, 0.3)) * np.eye(n)
    units, rows = (10.0 ** generator.uniform(-3, 3, k) for k in (n, 2))
    plant = GeneralizedPlant(
        A / units[:, None] * units,
        B / units[:, None],
        generator.standard_normal((n, 1)) / units[:, None],
        generator.standard_normal((2, n)) * units,
        generator.standard_normal((2, m)),
        np.zeros((2, 1)),
    )
    return scaled_gain(plant.measured(Cy * units * rows[:, None]), K / rows), generator


@pytest.mark.parametrize("seed", [0, 1])
def test_against_brute_force(seed):
    """On a grid over the errors of two readings nothing within what is proved does more than it may, nor within what is found but
    for a thousandth; and the errors that are named do."""
    gain, generator = _random(seed)
    found = fragility(gain)
    forces = gain.forces if gain.forces > 1 else 0
    assert np.any(found.stable.forces) == (forces > 0)  # one force is off as all its readings are
    for level, borne in ((np.inf, found.stable), *((found.norm * (1 + share), found.within[share]) for share in SHARES)):
        errors = np.concatenate([borne.readings, borne.forces])
        assert borne.proved_margin <= borne.smallest_violation
        assert np.abs(errors).max() == pytest.approx(min(borne.smallest_violation, 1.0), rel=1e-12)  # summed and taken apart
        if np.isfinite(borne.smallest_violation):
            assert norm_at(gain, 1 + (1 + NEAR) * errors) > level or np.isinf(level)
            assert np.isinf(norm_at(gain, 1 + (1 + NEAR) * errors)) or np.isfinite(level)
        for amount in (
            borne.proved_margin,
            min(borne.smallest_violation, 1.0) * (1 - 2e-3),
        ):  # it is looked inside a box a thousandth smaller
            sides = [np.linspace(-amount, amount, 9 if forces else STEPS)] * 2
            grid = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
            errors = np.hstack([grid, generator.uniform(-amount, amount, (len(grid), len(gain.K))) * (forces > 0)])
            poles, highest = _brute(gain, 1 + errors)
            assert poles < 0
            assert highest <= level * (1 + 1e-9)  # of rounding


def _brute(gain: ScaledGain, factors) -> tuple[float, float]:
    """The largest real part of a pole of any of many loops, and the largest gain of any at frequencies next to their poles."""
    M, n = gain.loops(factors), len(gain.plant.A)
    A, Bw, C, Dw = M[:, :n, :n], M[:, :n, n:], M[:, n:, :n], M[:, n:, n:]
    poles = np.linalg.eigvals(A)
    omega = np.unique(np.abs(poles[::7]).ravel().round(9))[:: max(1, poles.size // 700)]
    omega = np.concatenate([[0.0], omega, 1.1 * omega])
    highest = float(np.linalg.norm(Dw, axis=(-2, -1)).max())
    for at in omega:
        T = C @ np.linalg.solve(1j * at * np.eye(A.shape[-1]) - A, Bw) + Dw
        highest = max(highest, float(np.linalg.norm(T, axis=(-2, -1)).max()))  # of a column its length
    return float(poles.real.max()), highest


def test_an_unstable_loop_is_no_question():
    """A loop that is unstable as it is bears no error."""
    gain, _ = _random(0)
    with pytest.raises(ValueError, match="nominal loop is unstable"):
        fragility(replace(gain, plant=replace(gain.plant, A=gain.plant.A + 10 * np.eye(len(gain.plant.A)))))


def test_more_errors_than_corners_are_looked_at():
    """For more errors than corners allow an X for, multipliers prove a tenth less than the errors found at least."""
    gain, generator = _random(0)
    copies = 14  # sensors of the same two signals, each with a share of the gain
    shares = generator.uniform(0.05, 0.1, copies)
    many = replace(
        gain,
        K=np.hstack([gain.K[:, [i % 2]] * share for i, share in enumerate(shares)]),
        plant=gain.plant.rows([i % 2 for i in range(copies)]),
        before=np.zeros((1, copies)),
        readings=copies,
    )
    many = replace(many, plant=replace(many.plant, A=many.plant.A - 0.5 * np.eye(len(many.plant.A))))
    found = fragility(many)
    for one in (found.stable, *found.within.values()):
        assert 0.9 * min(one.smallest_violation, 1.0) <= one.proved_margin <= one.smallest_violation
        assert one.proof == "multipliers, computed twice"
    text = proved_text(found)
    assert text.startswith(
        f"stability is proved for each error up to {100 * found.stable.proved_margin:.4g} % (multipliers, computed twice)"
    )
    assert f"errors of {100 * found.within[0.01].smallest_violation:.4g} % violate this bound" in text


def test_rounding():
    """int16 keeps multiples of the largest entry over 32767, float16 eleven bits; entries beyond float16 by a power of two."""
    law = static_law(np.array([[10824.0, -2071.0, 0.0]]))
    steps = round_law(law, "int16").D / (10824 / 32767)
    assert steps == pytest.approx(np.round(steps), abs=1e-9)  # rounding of a product
    assert np.abs(round_law(law, "int16").D - law.D).max() <= 10824 / 32767 / 2
    assert round_law(law, "float16").D.tolist() == [[10824.0, -2072.0, 0.0]]  # in steps of 8 above 8192, of 2 above 2048
    law = LinearLaw(np.array([[0.5]]), np.array([[1e-3, 1.0]]), np.array([[1e5]]), np.array([[1.0, 3.0]]), 0.01)
    for to in ("int16", "float16"):  # each matrix of a law with states separately
        found = round_law(law, to)
        assert found.sample_period == 0.01
        for name in "ABCD":
            assert getattr(found, name) == pytest.approx(getattr(law, name), rel=2e-2)  # 1e-3 in int16 is 33 steps
    assert round_law(law, "int16").B[0, 0] != 1e-3
    large = round_law(static_law(np.array([[1e6, 1.0]])), "float16").D
    assert large[0, 0] == pytest.approx(1e6, rel=2**-11)
    assert large[0, 1] == pytest.approx(1.0, rel=2**-5)  # 2^-5 of it is below float16's normal numbers
    assert not np.any(round_law(static_law(np.zeros((1, 2))), "int16").D)


def test_the_command_prints_what_its_json_has(capsys):
    """`python -m synth --fragility` prints the errors of each loop, and nothing of a controller without one."""
    arguments = ["--controller", "passive", "--controller", "I_printed", "--fragility"]
    assert main(arguments) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert main([*arguments, "--json"]) == 0
    passive, one = json.loads(capsys.readouterr().out)["controllers"]
    assert "fragility" not in passive
    assert printed.count("fragility:") == 1
    assert {"norm", "stable", "within", "rounding"} == one["fragility"].keys()


def test_a_discrete_law_is_its_continuous_counterpart(tmp_path, capsys):
    """For a discrete law with states, errors are those of its continuous counterpart, whose norm is printed above."""
    path = tmp_path / "car.toml"
    law = "A = [[0.5]]\nB = [[0.5]]\nC = [[-4000.0]]\nD = [[-2000.0]]\nsample_period = 0.005\n"
    car = f"{read_vehicle('quarter_car').text}\n[implementation]\nsample_period = 0.005\n"
    path.write_text(f'{car}[controllers.lag]\nmeasured = ["sprung_velocity"]\n{law}')
    assert main(["--vehicle", str(path), "--controller", "lag", "--fragility", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["controllers"]
    assert one["fragility"]["norm"] == pytest.approx(one["norm"], rel=1e-9)  # a search ends at 1e-9
    assert 0 < one["fragility"]["within"][0]["proved"] <= one["fragility"]["within"][0]["found"]
