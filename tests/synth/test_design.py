"""Any plant: from numpy or a StateSpace, redundant measurements, why there is no design, and bad input."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.controller.report import notes
from synth.design.methods import design as design_for
from synth.design.problem import DesignProblem, DesignResult
from synth.design.static import static_output_feedback
from synth.design.two_step import state_design, state_feedback, state_path, two_step_design, zero_l_design
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError
from synth.vehicle.designer import Designer
from synth.vehicle.state_space import from_state_space
from tests.conftest import plant_with_feedthrough
from tests.support.commands import refused
from tests.support.shared import nothing_shared

GOOD = {
    "A": np.diag([-1.0, -2.0]),
    "B": np.ones((2, 1)),
    "Bw": np.ones((2, 1)),
    "C": np.eye(2),
    "D": np.zeros((2, 1)),
    "Dw": np.zeros((2, 1)),
}


def chosen(plant: GeneralizedPlant) -> DesignResult:
    """The static gain of a vehicle's plant, by the methods that it leads to."""
    return design_for(DesignProblem(plant, alternatives=False))


@pytest.fixture(scope="module")
def space(paper):
    """The paper's car as python-control has it."""
    model = paper.linear_model
    return control.StateSpace(
        model.A,
        np.hstack([model.B, model.Bw]),
        model.C,
        np.hstack([model.D, np.zeros((len(model.C), 1))]),
        inputs=[*model.inputs, *model.disturbances],
        outputs=list(model.outputs),
    )


def test_paper_from_a_state_space(space, designer, paper):
    """The paper's car as a StateSpace with named signals gives controller I."""
    plant, Cy = from_state_space(space, ["road_velocity"], paper.performance, ["suspension_deflection", "sprung_velocity"])
    design = two_step_design(plant, Cy)
    np.testing.assert_allclose(design.gain, designer.design("I").gain, rtol=1e-6)  # where the path is stopped, twice
    assert design.certificate.failures == ()


def test_redundant_measurements_are_left_out(designer):
    """A signal that follows from the others changes nothing, gets no gain, and is named; so with inputs that do the same."""
    alone = designer.design("I")
    Cy = np.eye(4)[[0, 2]]
    design = two_step_design(designer.plant, np.vstack([Cy, [[2.0, 0, -3.0, 0]]]), designer.state_path)
    assert design.redundant == (2,)
    np.testing.assert_allclose(design.gain[:, :2], alone.gain, rtol=1e-12)
    assert design.gain[0, 2] == 0

    plant = designer.plant
    twice = GeneralizedPlant(plant.A, np.hstack([plant.B] * 2), plant.Bw, plant.C, np.hstack([plant.D] * 2), plant.Dw)
    shared = two_step_design(twice, Cy).gain
    np.testing.assert_allclose(shared[0], shared[1], rtol=1e-9)  # rounding of a projection
    np.testing.assert_allclose(shared.sum(axis=0), alone.gain[0], rtol=1e-5)  # where the path is stopped


def oscillator() -> GeneralizedPlant:
    """One that is lightly damped; its force costs a little."""
    force = np.array([[0.0], [1.0]])
    A, C, D = np.array([[0, 1], [-4, -0.1]]), np.array([[1.0, 0], [0, 0]]), np.array([[0], [0.1]])
    return GeneralizedPlant(A, force, force, C, D, np.zeros((2, 1)))


@pytest.mark.parametrize("apart", [1e-2, 1e-5, 1e-7, 3e-8, 1e-9])
def test_nearly_dependent_signals_that_say_all(apart):
    """Two signals that differ by next to nothing still tell both states: the two steps give state feedback."""
    plant, Cy = oscillator(), np.array([[1, 1], [1, 1 + apart]])
    state = state_design(plant)
    for design in (
        two_step_design(plant, Cy),
        chosen(plant.measured(Cy)),
        zero_l_design(plant.measured(Cy)),
    ):
        assert design.certificate.failures == ()
        assert not design.instead
        assert not design.redundant
        # An entry of K is |G| / apart, and K C_y a difference of two such: rounding counts 1 / apart fold.
        np.testing.assert_allclose(design.gain @ Cy, state.gain, rtol=0, atol=(1e-6 + 4e-16 / apart) * np.abs(state.gain).max())


@pytest.mark.parametrize(("seed", "apart"), [(0, 1e-3), (1, 1e-6), (2, 1e-9)])
def test_a_design_depends_on_what_the_signals_span(seed, apart):
    """For the two steps: signals of which one nearly follows from the other give the loop that any others of their span give."""
    rng = np.random.default_rng(seed)
    plant, Cy = plant_with_feedthrough(seed), np.linalg.qr(rng.standard_normal((5, 3)))[0].T
    plant = replace(plant, A=plant.A - (np.linalg.eigvals(plant.A).real.max() + 0.2) * np.eye(5))  # so that 3 signals suffice
    mixed = np.array([[1.0, 0, 0], [1, apart, 0], [0, 0, 1]]) @ Cy
    path = state_path(plant)
    designs = [two_step_design(plant, rows, path) for rows in (Cy, mixed)]
    loops = [design.gain @ rows for design, rows in zip(designs, (Cy, mixed), strict=True)]
    # What rounding took of the rows counts 1 / apart fold; and 1e-6 for where the path is stopped.
    np.testing.assert_allclose(loops[1], loops[0], rtol=0, atol=(1e-6 + 1e-14 / apart) * np.abs(loops[0]).max())
    assert designs[1].certificate.failures == ()


@pytest.mark.parametrize("seed", range(4))
def test_no_unit_makes_a_measurement_redundant(seed):
    """Two steps in units of states, inputs and measurements from 1e-8 to 1e8: the same gain, and the same signals in vain."""
    rng = np.random.default_rng(seed)
    n, m = 4, 1
    A, B, Bw, Cy = (rng.standard_normal(shape) for shape in ((n, n), (n, m), (n, 1), (3, n)))
    A[:2, 2:] = 0  # a block that is not driven by the other: its units do not follow from A alone
    A -= (np.linalg.eigvals(A).real.max() + 0.2) * np.eye(n)
    C, D = np.vstack([rng.standard_normal((2, n)), np.zeros((m, n))]), np.vstack([np.zeros((2, m)), np.eye(m)])
    plant = GeneralizedPlant(A, B, Bw, C, D, np.zeros((2 + m, 1)))
    Cy = np.vstack([Cy[:2], 2 * Cy[0] - 3 * Cy[1], Cy[2]])
    own = two_step_design(plant, Cy)
    x = 2.0 ** rng.permutation([-26, -26, 26, 26])  # to rounding two of three independent rows fill what is large
    u, y = (2.0 ** rng.integers(-26, 27, size) for size in (m, len(Cy)))
    moved = two_step_design(plant.in_coordinates(np.diag(x)).with_inputs(np.diag(u)), y[:, None] * Cy * x)
    assert own.redundant == moved.redundant == (2,)
    assert moved.certificate.norm.value == pytest.approx(own.certificate.norm.value, rel=1e-6)  # where the path is stopped
    assert moved.certificate.failures == own.certificate.failures == ()


def test_redundant_signal_of_a_vehicle_is_named():
    """In a vehicle file, too: a full car's heave, pitch and roll follow from signals at its corners."""
    car = read_vehicle("full_car")
    measured = [name for name in car.linear_model.measurable if "tyre_deflection" in name or "velocity" in name or "rate" in name]
    rank = np.linalg.matrix_rank(car.linear_model.rows(measured)[0])
    assert rank < len(measured)
    text = car.text + "\n[controllers.many]\nmeasured = " + str(measured).replace("'", '"')
    controller = Designer(parse_vehicle(text)).design("many")
    assert controller.certificate.failures == ()
    assert len(controller.redundant) == len(measured) - rank
    assert any(note.startswith("redundant: ") for note in notes(controller))


def plant_of(A, B, dt: float | None = None) -> GeneralizedPlant:
    A, B = np.array(A, dtype=float), np.array(B, dtype=float)
    n, m = B.shape
    C = np.vstack([np.eye(n), np.zeros((m, n))])
    return GeneralizedPlant(A, B, np.ones((n, 1)), C, np.vstack([np.zeros((n, m)), np.eye(m)]), np.zeros((n + m, 1)), dt=dt)


@pytest.mark.parametrize("name", ["state", "I"])
def test_a_gain_that_is_not_settled_is_said(paper, name):
    """From a path that ends early the gain still moves, by what its last points are apart, and it is said."""
    whole = Designer(paper)
    settled = whole.design(name)
    assert 0 < settled.steps.moved < 4e-5  # measured 2.4e-5 and 3.4e-6
    assert not any("not settled" in note for note in notes(settled))
    ends_early = Designer(paper)
    ends_early.shared().state_path = [point for point in whole.state_path if point.mu > 1e-3]
    early = state_design(ends_early.plant, ends_early.state_path)
    before, last = (point.K for point in ends_early.state_path[-2:])
    assert early.moved == np.abs(last - before).max() / np.abs(last).max()
    if name == "state":
        percent = f"{100 * early.moved:.2g}"
        with nothing_shared():  # as it is another path than the vehicle's own
            (note,) = notes(ends_early.design("state"))
        assert note.startswith(f"the gain did not converge: the last step of the central path changed it by {percent} % of its")


CHAIN = np.diag(np.ones(2), 1)
NO_DESIGN = (  # A, B, C_y, the period, and why
    ([[1, 0], [0, -1]], [[0], [1]], [[1, 1]], None, r"no input acts on the mode at 1 1/s.*in x1"),
    ([[0, 1, 0], [-4, 0, 0], [0, 0, -1]], [[0], [0], [1]], np.eye(3), None, r"no input acts on the mode at 0\+2j rad/s.*in x1"),
    ([[1, 0], [0, -1]], [[1], [1]], [[0, 1]], None, r"none of them contains the mode at 1 1/s.*in x1"),
    (CHAIN[:2, :2], [[0], [1]], [[1, 0]], None, r"mode at 0 rad/s does not decay: .*\(C_y B = 0\)"),
    (CHAIN, [[0], [0], [1]], [[1, 0, 0]], None, r"mode at 0 rad/s does not decay: .*\(C_y B = 0\)"),
    ([[0, 1], [-1, 0]], [[0], [1]], [[1, 0]], None, r"mode at 0\+1j rad/s does not decay: .*C_y B = 0.*all poles stays 0 1/s"),
    ([[0, 1], [1, 0]], [[0], [1]], [[1, 0]], None, r"mode at 1 1/s does not decay: .*C_y B = 0"),
    ([[0, 1], [1, 0]], [[0], [1]], [[0, 1]], None, r"mode at 1 1/s does not decay: .*one pole stays real and above zero"),
    ([[1.2, 0], [0, 0.5]], [[0], [1]], [[1, 1]], 0.1, "no input acts on the mode at z = 1.2, which does not decay"),
    ([[-1, 0], [0, 0.5]], [[0], [1]], [[1, 1]], 0.1, "no input acts on the mode at z = -1, which does not decay"),
    ([[1, 0], [0, 0.5]], [[0], [1]], [[1, 1]], 0.1, "no input acts on the mode at z = 1, which does not decay"),
    ([[1.2, 0], [0, 0.5]], [[1], [1]], [[0, 1]], 0.1, "none of them contains the mode at z = 1.2, which does not decay"),
    ([[0, 1, 0], [0, 0, 0], [0, 0, -100]], [[0], [1], [1]], [[1, 0, 0]], None, "sum of the poles that a gain moves stays 0 1/s"),
    ([[1.5, 1], [0, 0.8]], [[0], [1]], [[1, 0]], 0.1, r"C_y B = 0\), so the sum of all poles stays 2.3 \(of 2 poles\)"),
)


@pytest.mark.parametrize("design", [two_step_design, chosen])
@pytest.mark.parametrize(("A", "B", "Cy", "dt", "message"), NO_DESIGN)
def test_what_no_static_gain_stabilises_is_named(design, A, B, Cy, dt, message):
    """If no input reaches a mode, no measurement shows it, or no static gain moves it, one line names it; no search."""
    with pytest.raises(InfeasibleError, match=message) as caught:
        design(plant_of(A, B, dt).measured(Cy))
    assert len(str(caught.value).splitlines()) == 1


def test_masses_in_a_row_are_damped():
    """Chains of integrators have no time of their own: all poles are 0 but for rounding. From all states they are damped."""
    assert state_design(plant_of(CHAIN, np.eye(3)[:, -1:])).certificate.failures == ()


def test_input_that_costs_nothing_has_a_bound():
    """A column of zeros in D does not end `find_lower_bound`."""
    plant = GeneralizedPlant(
        A=np.diag([-1.0, -2.0]),
        B=np.array([[1.0, 1.0], [0.0, 1.0]]),
        Bw=np.ones((2, 1)),
        C=np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]),
        D=np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]]),
        Dw=np.zeros((3, 1)),
    )
    assert 0 <= find_lower_bound(plant, np.ones((1, 2))).gamma < 1.2  # its norm without control is 1.118


def test_optimum_at_infinite_gain_is_said():
    """A force that costs nothing pushes z to zero the harder the larger it is: the optimum lies at infinite gain."""
    plant = GeneralizedPlant(
        A=np.zeros((1, 1)), B=np.ones((1, 1)), Bw=np.ones((1, 1)), C=np.ones((1, 1)), D=np.zeros((1, 1)), Dw=np.zeros((1, 1))
    )
    with pytest.raises(DesignError, match="only an infinite gain reaches the optimum"):
        state_feedback(plant)


@pytest.mark.parametrize(
    "act",
    [
        state_design,
        lambda plant: two_step_design(plant, np.zeros((1, 0))),
        lambda plant: static_output_feedback(plant, np.zeros((1, 0))),
    ],
    ids=["state", "two steps", "descent"],
)
def test_a_plant_without_a_state_is_refused(act):
    """Every door says so, in one line."""
    none, direct = np.zeros((0, 1)), np.ones((1, 1))
    with pytest.raises(InputError, match=r"^A has shape \(0, 0\), so the plant has no states; give at least one state$"):
        act(GeneralizedPlant(np.zeros((0, 0)), none, none, none.T, direct, direct))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"B": np.ones((3, 1))}, r"B has shape \(3, 1\), but must have the shape \(2, 1\)"),
        ({"C": np.ones((2, 3))}, r"C has shape \(2, 3\), but must have the shape \(2, 2\)"),
        ({"Dw": np.ones((1, 1))}, r"Dw has shape \(1, 1\), but must have the shape \(2, 1\): A has 2 row"),
        ({"A": np.array([1.0, 2.0])}, r"A has shape \(2,\); expected a matrix of shape \('n', 'n'\)"),
        ({"A": np.array([[np.nan, 0.0], [0.0, 1.0]])}, "A has an entry that is not finite"),
        ({"A": [["a", "b"], ["c", "d"]]}, "A is not a matrix of numbers"),
        ({"A": [[1.0, 2.0], [3.0]]}, "A is not a matrix of numbers .*rows of the same length"),
        ({"A": np.diag([-1.0 + 1e-3j, -2.0])}, "A has complex entries; give real numbers"),
        ({"A": np.broadcast_to(0.0, (100_000, 100_000))}, r"A has shape \(100000, 100000\); at most 2000 rows"),
        ({"B": np.full((2, 1), 1e200)}, r"B has an entry with a magnitude above 1e\+50; use units"),
        ({"Bw": np.full((2, 1), 1e-200)}, r"Bw has no entry above 1e-50 \(the largest is 1e-200\)"),
        ({"C": np.zeros((0, 2)), "D": np.zeros((0, 1)), "Dw": np.zeros((0, 1))}, "C has no rows"),
        ({"Bw": np.zeros((2, 0)), "Dw": np.zeros((2, 0))}, "Bw has no columns, so there is no norm from w to z"),
        ({"Bw": np.zeros((2, 1))}, "no disturbance acts on the plant, because all entries of Bw and Dw are zero"),
        ({"C": np.zeros((2, 2))}, "the controlled output z is always zero"),
        ({"dt": -0.01}, "dt = -0.01 is not a sample period.*give the seconds between samples"),
        ({"dt": float("nan")}, "dt = nan is not a sample period.*give the seconds between samples"),
        ({"dt": True}, "dt = True is not a number"),
        ({"dt": [0.1]}, "is not a number"),
        ({"dt": 10**400}, "is not a number"),
    ],
)
def test_matrices_that_do_not_fit(change, message):
    """A matrix or period that cannot be is named with what was found and expected, and nothing is designed without w or z."""
    with refused(match=message):
        state_path(GeneralizedPlant(**{**GOOD, **change}))


@pytest.mark.parametrize(
    ("Cy", "message"),
    [
        (np.ones((1, 3)), r"Cy has shape \(1, 3\); expected \(q, 2\)"),
        (np.zeros((0, 2)), "no signal is measured"),
        (np.array([[1.0, 0.0], [0.0, 0.0]]), "row 1 of Cy is zero"),
        (np.array([[1.0, 0.0], [0.0, 1e-200]]), "row 1 of Cy is below 1e-50"),
        (np.array([[1.0, 0.0], [0.0, 1e200]]), r"Cy has an entry with a magnitude above 1e\+50; use units"),
    ],
)
def test_measurements_that_do_not_fit(Cy, message):
    """So is a measurement that is none."""
    for use in (two_step_design, find_lower_bound):
        if use is find_lower_bound and message == "no signal is measured":
            continue  # of that there is a bound
        with refused(match=message):
            use(GeneralizedPlant(**GOOD), Cy)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"disturbances": ["rain"]}, "unknown disturbance 'rain'; the system has control_force, road_velocity"),
        ({"disturbances": []}, "no disturbance is given"),
        ({"performance": {"noise": 1.0}}, "unknown performance signal 'noise'"),
        ({"performance": {"tyre_deflection": 0.0}}, "all weights are zero"),
        ({"measured": ["speed"]}, "unknown measured signal 'speed'"),
        ({"measured": []}, "no signal is measured"),
        ({"measured": ["sprung_acceleration"]}, "'sprung_acceleration' depends directly on an input"),
    ],
)
def test_state_space_that_does_not_fit(space, change, message):
    """Signals of a StateSpace are known by name; a wrong one is answered with those there are."""
    good = {"disturbances": ["road_velocity"], "performance": {"tyre_deflection": 1.0}, "measured": ["tyre_deflection"]}
    with pytest.raises(InputError, match=message):
        from_state_space(space, **{**good, **change})


def test_sampled_state_space_is_a_discrete_plant(space):
    """python-control's system with its inputs held comes in as the discrete plant that it is, and is designed as such."""
    asked = ["road_velocity"], {"sprung_acceleration": 1.0, "control_force": 1e-4}, ["suspension_deflection", "sprung_velocity"]
    plant, Cy = from_state_space(control.c2d(space, 0.01), *asked)
    continuous, _ = from_state_space(space, *asked)
    assert plant.dt == 0.01
    np.testing.assert_allclose(plant.A, linalg.expm(0.01 * continuous.A), rtol=1e-12, atol=1e-14)  # two exponentials
    assert two_step_design(plant, Cy).certificate.failures == ()
