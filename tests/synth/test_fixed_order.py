"""Laws of a given order or structure: what they reach, that nothing else reaches less, and that they are what they are called."""

import functools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import linalg, optimize

from models.common.errors import InputError
from models.laws.design_request import LawStructure
from models.laws.law_structure import pid_gains
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.stability.study import check_loop
from synth.analysis.certificate import FASTEST
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.analysis.norm import hinf_norm
from synth.command.table import Row, answers
from synth.controller.design_notes import pid_line, sign_note
from synth.design.feedback import design_feedback
from synth.design.fixed_order.fixed_order import _Search, fixed_order_design
from synth.design.fixed_order.pattern import structured_gain
from synth.design.full_order.full_order import as_designed
from synth.design.problem import DesignResult
from synth.design.static import Candidate
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import InfeasibleError
from synth.vehicle.designer import Designer
from tests.claims.test_no_controller_beats_a_bound import of_lists
from tests.support.commands import attacks

Posed = tuple[GeneralizedPlant, np.ndarray, np.ndarray]
GRID = np.concatenate([[0.0], np.geomspace(1e-2, 1e2, 300)])  # rad/s


def posed(seed: int, m: int = 1, n: int = 3) -> Posed:
    """A random stable plant of three states with noise, where a static gain is far from what a law of full order reaches."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(n)
    B, Bw = rng.standard_normal((n, m)), np.hstack([rng.standard_normal((n, 1)), np.zeros((n, m))])
    C, D = np.vstack([rng.standard_normal((1, n)), np.zeros((m, n))]), np.vstack([np.zeros((1, m)), np.eye(m)])
    plant = GeneralizedPlant(A, B, Bw, C, D, np.zeros((1 + m, 1 + m)))
    return plant, rng.standard_normal((m, n)), np.hstack([np.zeros((m, 1)), 0.3 * np.eye(m)])


def largest_gain(plant: GeneralizedPlant, Cy: np.ndarray, Dyw: np.ndarray) -> Callable[[LinearLaw], float]:
    """Returns the loop's gain on a grid, for one force and one measurement; infinite of an unstable loop.

    T = P_zw + P_zu K (1 - P_yu K)^-1 P_yw.
    """
    inverse = np.linalg.inv(1j * GRID[:, None, None] * np.eye(len(plant.A)) - plant.A)
    zu, yu = plant.C @ inverse @ plant.B + plant.D, Cy @ inverse @ plant.B
    zw, yw = plant.C @ inverse @ plant.Bw + plant.Dw, Cy @ inverse @ plant.Bw + Dyw

    def on_grid(law: LinearLaw) -> float:
        loop = np.block([[plant.A + plant.B @ law.D @ Cy, plant.B @ law.C], [law.B @ Cy, law.A]])
        if np.linalg.eigvals(loop).real.max() >= 0:
            return np.inf
        K = law.D + law.C @ np.linalg.solve(1j * GRID[:, None, None] * np.eye(law.states) - law.A, law.B.astype(complex))
        return float(np.linalg.norm(zw + zu @ (K / (1 - yu * K)) @ yw, 2, axis=(1, 2)).max())

    return on_grid


def of_numbers(x: np.ndarray) -> LinearLaw:
    """A law of one state, in its controllable form: D + C / (s - A)."""
    return LinearLaw(x[None, :1], np.ones((1, 1)), x[None, 1:2], x[None, 2:])


@functools.cache
def found_for(seed: int, order: int) -> DesignResult:
    """The law of an order for `posed`."""
    return fixed_order_design(posed(seed)[0].measured(*posed(seed)[1:]), LawStructure(order))


@pytest.mark.attack
@pytest.mark.parametrize("seed", [6, 10, 13])
def test_no_other_law_of_its_order_is_better(seed):
    """Simplexes on a grid's maximum, from many starts and from the law itself, find no law of one state that is better."""
    plant, Cy, Dyw = posed(seed)
    found = found_for(seed, 1)
    assert found.certificate.failures == ()
    assert found.law.states <= 1
    assert found.certificate.norm.value <= found_for(seed, 0).certificate.norm.value * (1 + 1e-9)  # a gain is such a law, too
    rng, on_grid = np.random.default_rng(seed), largest_gain(plant, Cy, Dyw)
    starts = [np.array([-(10 ** rng.uniform(-1, 1)), *rng.standard_normal(2)]) for _ in range(4)]
    if found.law.states:
        starts.append(np.array([found.law.A[0, 0], found.law.B[0, 0] * found.law.C[0, 0], found.law.D[0, 0]]))
    ends = [
        optimize.minimize(lambda x: min(on_grid(of_numbers(x)), 1e6), start, method="Nelder-Mead", options={"maxfev": 200}).fun
        for start in starts
    ]
    # A search ends within 0.1 % of the lower bound, or where descent gains 0.03 %; a grid misses less of a peak's height.
    assert found.certificate.norm.value <= min(ends) * (1 + 1.5e-3)
    assert on_grid(found.law) == pytest.approx(found.certificate.norm.value, rel=1e-3)  # likewise


@pytest.mark.attack
def test_more_states_are_no_worse():
    """Norms fall with the order; one state less than the plant's comes next to what no controller beats, and says so of more."""
    norms = [found_for(10, order).certificate.norm.value for order in range(3)]
    assert norms[0] > 1.3 * norms[1] > 1.3 * 1.2 * norms[2]  # 2.477, 1.628 and 1.259: measured
    gap = found_for(10, 2).certificate.gap
    assert gap is not None
    assert 0 <= gap <= 1e-3  # where the search ends


def of_entries(A: float, B: float, C: float, D: float) -> LinearLaw:
    """A law of one state, one measurement and one force."""
    return LinearLaw(np.array([[A]]), np.array([[B]]), np.array([[C]]), np.array([[D]]))


def test_a_limit_on_entries_does_not_end_a_descent():
    """From where a limit on entries stops it, descent for a double integrator goes on to larger ones: 0.1313 to below 0.1022.

    A law with A = -93.9, B C = 4.34e5, D = -4674 has 0.1022: found by simplexes from many starts.
    """
    plant = of_lists([[0, 1], [0, 0]], [[0], [1]], [[0], [1]], [[1, 0], [0, 0]], [[0], [0.1]])
    law = of_entries(-12.3705, 33.0421, 33.0421, -100.0)
    search = _Search(plant.measured([[1.0, 0.0]]), LowerBound(0.1), False, as_designed)
    problem = structured_gain(LawStructure(1), search.plant)
    landscape = search.of(problem, 1, 100.0).landscape
    x = landscape.point(problem.gain(law))
    start = Candidate(x, landscape.norm(x)[0], "known")
    assert start.norm == pytest.approx(0.1313465, rel=1e-5)  # six digits of the entries
    end = search.further(problem, 1, start, 100.0, search.beyond_rounding(law, "known"))
    further, found = end.law, search.certified(end.law)
    assert found.failures == ()
    assert found.speed_up <= search.most
    assert found.norm.value < 0.1022
    assert search.capped == bool(np.abs(further.D).max() > 9.9e3)  # a hundred times the limit


def held(rate: float, dt: float | None, cost: float) -> GeneralizedPlant:
    """x' = rate (u + w - x), held over dt if it is given, and z = (x, cost u)."""
    share, one = (rate if dt is None else 1 - np.exp(-rate * dt)), np.eye(1)
    kept = -share if dt is None else 1 - share
    C, D = np.array([[1.0], [0.0]]), np.array([[0.0], [cost]])
    return GeneralizedPlant(kept * one, share * one, share * one, C, D, 0 * D, dt=dt)


@pytest.mark.parametrize(("rate", "dt"), [(1.0, 1e-3), (0.01, 0.1)])
def test_a_loop_may_be_as_fast_as_its_samples_follow(rate, dt):
    """At a thousandth of the plant's time a loop a hundred times as fast is not too fast, and the limit on gains ends it."""
    plant, start = held(rate, dt, 0.02), LinearLaw(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), -np.eye(1))
    found = fixed_order_design(plant.measured(np.eye(1)), LawStructure(0), lower_bound=LowerBound(0.0), known=[start])
    assert found.certificate.speed_up > FASTEST
    assert found.certificate.norm.value == pytest.approx((1 + 2**2) ** 0.5 / 101, rel=1e-3)  # of u = -100 x, which it nears


@pytest.mark.parametrize("dt", [None, 0.01])
def test_states_at_zero_that_do_nothing_are_moved(dt):
    """A law whose states read nothing and stand still is given with states that decay slowly, and the norm of its gain."""
    search = _Search(held(10.0, dt, 0.1).measured(np.eye(1)), LowerBound(0.0), False, as_designed)
    still = np.zeros((2, 2)) if dt is None else np.eye(2)
    law = LinearLaw(still, np.zeros((2, 1)), np.ones((1, 2)), -np.eye(1), dt)
    assert search.certified(law).failures
    moved, _, certificate = search.beyond_rounding(law, "known")
    assert certificate.failures == ()
    assert certificate.norm.value == pytest.approx(1.01**0.5 / 2, rel=1e-9)  # of u = -x, where a norm stops
    assert search.certified(moved).failures == ()
    np.testing.assert_array_equal(moved.D, law.D)
    decay = -np.diag(moved.A) if dt is None else -np.log(np.diag(moved.A)) / dt
    assert np.all((decay > 10.0 * 0.9e-6) & (decay < 10.0 * 1e-2))  # SHIFTS, of a plant that is 5 % slower in differences


@pytest.mark.attack
@pytest.mark.parametrize("rows", [((True, False), (False, True)), None])
def test_a_known_law_may_have_fewer_states(rows):
    """A descent starts from a law of fewer states than it may have, one for all forces or one for each, and ends lower."""
    plant, Cy, _ = posed(2, m=2, n=2)
    nothing = LinearLaw(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.zeros((2, 2)))
    found = fixed_order_design(plant.measured(Cy), LawStructure(1, rows), lower_bound=LowerBound(0.0), known=[nothing])
    assert found.law.states == (1 if rows is None else 2)
    assert found.certificate.failures == ()
    assert found.certificate.norm.value < hinf_norm(plant).value


@pytest.mark.parametrize(("order", "delay"), [(1, 1.0), *attacks([(2, 0.0), (2, 0.5)])])
def test_any_order_is_designed_for_the_sampled_loop(order, delay):
    """An order beside a sample period has a law; one of fewer states says that it has fewer, and why."""
    oscillator = of_lists([[0, 1], [-4, -0.1]], [[0], [1]], [[0], [1]], [[1, 0], [0, 0]], [[0], [0.1]])
    found = design_feedback(oscillator, np.array([[0.0, 1.0]]), order=order, sample_period=0.1, delay=delay)
    assert found.value < hinf_norm(oscillator).value
    assert (f"of at most {order} state" in found.remark) == (found.law.states < order), found.remark


@pytest.mark.attack
def test_each_force_has_a_law_of_its_own():
    """With rows of a structure and an order the law is block diagonal, exactly, and better than a static gain so built."""
    plant, Cy, Dyw = posed(2, m=2, n=2)
    static = fixed_order_design(plant.measured(Cy, Dyw), LawStructure(0, ((True, False), (False, True)))).certificate.norm.value
    found = design_feedback(plant, Cy, Dyw, order=1, structure=np.eye(2))
    law = found.law
    for matrix in (law.A, law.B, law.C, law.D):
        np.testing.assert_array_equal(matrix * (1 - np.eye(2)), 0)
    assert found.certificate.failures == ()
    assert found.certificate.norm.value < 0.999 * static


@pytest.mark.attack
def test_stable_and_discrete():
    """`stable` goes with an order, and a discrete plant has a discrete law, both certified."""
    plant, Cy, Dyw = posed(9, n=2)
    calm = fixed_order_design(plant.measured(Cy, Dyw), LawStructure(1), stable=True)
    assert calm.law.growth == 0
    assert calm.certificate.failures == ()
    step = linalg.expm(0.1 * np.block([[plant.A, plant.B, plant.Bw], [np.zeros((3, 5))]]))
    held = GeneralizedPlant(step[:2, :2], step[:2, 2:3], step[:2, 3:], plant.C, plant.D, plant.Dw, dt=0.1)
    found = design_feedback(held, Cy, Dyw, order=1)
    assert found.law.sample_period == 0.1
    assert found.certificate.failures == ()


def quarter_car(section: str, more: str = "") -> Designer:
    """The quarter-car with a controller `mine`."""
    return Designer(parse_vehicle(f"{read_vehicle('quarter_car').text}\n{more}\n[controllers.mine]\n{section}\n"))


def pid_section(**numbers: float) -> str:
    table = ", ".join(f"{name} = {value!r}" for name, value in numbers.items())
    return f'measured = ["suspension_deflection"]\npid = {{ {table} }}'


def test_a_pid_law_is_its_formula():
    """The law of `pid` answers kp + ki / s + kd s / (filter s + 1), and has a state for each part that acts, no other."""
    for numbers, states in (
        ({"kp": 3.0, "ki": 5.0, "kd": 0.2, "filter": 0.02}, 2),
        ({"kp": 3.0, "ki": 5.0}, 1),
        ({"kd": 0.2, "filter": 0.02}, 1),
        ({"kp": 3.0}, 0),
    ):
        law = quarter_car(pid_section(**numbers)).vehicle.controllers["mine"].law
        assert law is not None
        assert law.states == states
        for omega in (0.1, 3.0, 80.0):
            s = 1j * omega
            expected = numbers.get("kp", 0) + numbers.get("ki", 0) / s
            expected += numbers.get("kd", 0) * s / (numbers.get("filter", 1) * s + 1)
            assert law.response(omega)[0, 0] == pytest.approx(expected, rel=1e-12)  # a handful of operations


@pytest.mark.parametrize("sampled", [False, *attacks([True])])
def test_a_designed_pid_is_the_one_that_its_gains_make(sampled):
    """A designed PID says its gains; given as numbers they make its loop, as a computer runs it too, and --save keeps it."""
    more = "[implementation]\nsample_period = 0.01" if sampled else ""
    section = 'measured = ["suspension_deflection"]\nstructure = "pid"\npid = { filter = 0.02 }'
    found = quarter_car(section + "\nsampled = true" * sampled, more).design("mine")
    assert found.certificate.failures == ()
    assert found.certificate.gap is not None
    assert found.certificate.gap < 0.01
    said = next(remark for remark in found.remarks if "pid = {" in remark)
    written = said[said.index("pid = {") :].split("}")[0] + "}"
    given = quarter_car(f'measured = ["suspension_deflection"]\n{written}', more).vehicle.controllers["mine"].law
    assert given is not None
    assert pid_line(found) == written.replace("  ", " ")
    assert [one.text for one in answers([Row("mine", found, (), ())], True)] == [f"`mine`: {written}".replace("  ", " ")]
    period = 0.01 if sampled else None
    mine, own = (law.sampled(0.01) if sampled else law for law in (given, found.law))
    assert own.sample_period == period
    for omega in (1.0, 30.0):
        np.testing.assert_allclose(mine.response(omega), own.response(omega), rtol=1e-4)  # printed with six digits


def test_corners_have_controllers_of_their_own():
    """A half-car's corners each have a PID law on their own deflection; each gain stands in a table of its own."""
    text = read_vehicle("half_car").text
    deflections = ["suspension_deflection_rear", "suspension_deflection_front"]  # in another order than the forces
    pid = f"measured = {json.dumps(deflections)}\npid = {{ kp = [-300.0, -400.0], ki = -10.0 }}"
    law = parse_vehicle(f"{text}\n[controllers.mine]\n{pid}\n").controllers["mine"].law
    assert law is not None
    np.testing.assert_array_equal(law.D, [[0, -300], [-400, 0]])
    np.testing.assert_allclose(law.response(1.0), [[0, -300 + 10j], [-400 + 10j, 0]], atol=1e-12)


@pytest.mark.parametrize("gains", [{"ki": -10.0}, {"kp": -3.0, "kd": 40.0}, {"kp": 1.5, "ki": 2.0, "kd": -4.0}])
def test_a_pid_law_is_told_by_its_numbers(gains):
    """A law's matrices say which PID made them, on one force or on each of two; a law of an order is none."""
    numbers = {**gains, "filter": 0.03} if "kd" in gains else gains
    pid = f"pid = {{ {', '.join(f'{name} = {value}' for name, value in numbers.items())} }}"
    law = quarter_car(f'measured = ["suspension_deflection"]\n{pid}').vehicle.controllers["mine"].law
    text = f'[controllers.mine]\nmeasured = ["suspension_deflection_front", "suspension_deflection_rear"]\n{pid}'
    both = parse_vehicle(f"{read_vehicle('half_car').text}\n{text}").controllers["mine"].law
    assert law is not None
    assert both is not None
    tables = [*pid_gains(law), *pid_gains(both)]
    assert len(tables) == 3
    for found in tables:
        given = {name: value for name, value in found.items() if value}
        assert given == pytest.approx(numbers, rel=1e-9)  # a handful of operations
    assert pid_gains(LinearLaw(np.array([[-5.0]]), np.array([[1.0]]), np.array([[30.0]]), np.zeros((1, 1)))) == []


def test_an_unstable_pid_says_what_its_signs_mean():
    """Positive gains on an extension push with it: where such a loop is unstable synth and sim.margins say so, of others not."""
    designer = quarter_car(pid_section(kp=2000.0, ki=500.0))
    wrong = designer.design("mine")
    (failure,) = answers([Row("mine", wrong, (), wrong.certificate.failures)], True)
    assert failure.text.startswith("`mine` FAILS: unstable: a pole at 0.04497 1/s; a positive kp, ki or kd lifts the body")
    with pytest.raises(InputError, match="give negative gains to oppose it"):
        check_loop(designer.vehicle, designer.vehicle, wrong, 1e-3)
    right = quarter_car(pid_section(kp=-2000.0, ki=-500.0)).design("mine")
    assert sign_note(right) == ""


def test_an_integral_that_nothing_moves_is_said():
    """A loop with a pole at 0 says why it has no norm; a design of such a law is refused with the reason."""
    section = 'measured = ["sprung_velocity"]\n'
    from synth.controller.integral_action import IDLE_INTEGRAL
    from synth.controller.report import growth_lines

    designer = quarter_car(section + "pid = { kp = -800.0, ki = -200.0 }")
    given = designer.design("mine")
    assert given.certificate.failures[0].startswith("marginal: a pole at 0")
    assert IDLE_INTEGRAL in growth_lines(designer.vehicle, given)
    assert IDLE_INTEGRAL not in growth_lines(designer.vehicle, quarter_car(pid_section(kp=-800.0, ki=-200.0)).design("mine"))
    with pytest.raises(InfeasibleError, match="integrates a signal that no constant force changes"):
        quarter_car(section + 'structure = "pi"').design("mine")


def test_the_certificate_is_of_the_laws_own_loop():
    """A law of a structure on readings that contain the force is certified with that loop solved."""
    section = 'measured = ["suspension_deflection", "sprung_acceleration"]\nstructure = "corner"\norder = 1\nnoise = true'
    designer = quarter_car(section, "[implementation]\nsample_period = 0.005\nnoise = { sprung_acceleration = 0.05 }")
    found = designer.design("mine")
    other: Any = designer.certify("mine", found.measured, found.law, found.hardware)
    assert found.certificate.failures == ()
    assert found.certificate.norm.value == pytest.approx(other.certificate.norm.value, rel=1e-9)  # two routes of a norm
