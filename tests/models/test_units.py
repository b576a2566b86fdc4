"""The same plant in other units has the same design: no unit decides a rank, a path, where it rests, or what is too fast."""

import numpy as np
import pytest

from models.common.errors import InputError
from synth.design.problem import DesignResult
from synth.design.two_step import state_design, state_path, two_step_design, zero_l_design
from synth.lmi.central_path import CENTRE_DECREMENT
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.plant.units import own_units, speed
from tests.support.commands import attacks


def a_plant(seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A random plant and what it measures; of some the optimum lies at infinite gain, and all states are measured."""
    rng = np.random.default_rng(seed)
    n, m, r, d = int(rng.integers(2, 5)), int(rng.integers(1, 3)), int(rng.integers(1, 3)), int(rng.integers(1, 4))
    A, C = rng.standard_normal((n, n)), np.vstack([rng.standard_normal((d, n)), np.zeros((m, n))])
    D = np.vstack([np.zeros((d, m)), (0.1 if seed % 3 else 1e-3) * np.eye(m)])
    plant = GeneralizedPlant(A, rng.standard_normal((n, m)), rng.standard_normal((n, r)), C, D, np.zeros((d + m, r)))
    return plant, np.eye(n) if seed % 2 else rng.standard_normal((max(n - 1, 1), n))


def in_other_units(plant: GeneralizedPlant, Cy: np.ndarray, seed: int) -> tuple[GeneralizedPlant, np.ndarray, float]:
    """The same in units by powers of ten, of states, inputs, measurements, w, z, time, and what a norm of one counts in them."""
    rng = np.random.default_rng([7, seed])
    (x, u, y), (w, z, t) = (
        (10.0 ** rng.integers(-5, 6, k) for k in (len(plant.A), plant.B.shape[1], len(Cy))),
        10.0 ** rng.integers(-3, 4, 3),
    )
    moved = GeneralizedPlant(
        t * plant.A * x / x[:, None],
        t * plant.B * u / x[:, None],
        t * w * plant.Bw / x[:, None],
        z * plant.C * x,
        z * plant.D * u,
        z * w * plant.Dw,
    )
    return moved, Cy * x * y[:, None], z * w


def any_plant(seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A random plant of 2 to 6 states, stable or not, of small integers, or a chain of integrators; and what it measures.

    Of some z does not see a state, or as many forces as there are outputs can keep every state out of it.
    """
    rng = np.random.default_rng([9, seed])
    n, m, r, d = int(rng.integers(2, 7)), int(rng.integers(1, 3)), int(rng.integers(1, 3)), int(rng.integers(1, 4))
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, m))
    kind = seed % 4
    if kind == 1:
        A = A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
    if kind == 2:
        A = np.round(A)
    if kind == 3:
        A, B[:, 0] = np.diag(np.ones(n - 1), 1), np.eye(n)[-1]
    C = np.vstack([rng.standard_normal((d, n)), np.zeros((m, n))])
    D = np.vstack([np.zeros((d, m)), 10.0 ** rng.uniform(-3, 0.5) * np.eye(m)])
    if seed % 5 == 0 and n > 2:
        A[:-1, -1], C[:, -1], A[-1, -1] = 0, 0, -1
    if seed % 5 == 1:
        C, D = C[:1], 0.3 * np.eye(1)
        B, d, m = B[:, :1], 0, 1
    q = int(rng.integers(1, n + 1))
    Cy = rng.standard_normal((q, n)) if seed % 3 else np.eye(n)[:q]
    return GeneralizedPlant(A, B, rng.standard_normal((n, r)), C, D, np.zeros((d + m, r))), Cy


class Moved:
    """A plant in units of states, inputs, measurements, all of w, all of z and time between 2^-16 and 2^16, powers of two."""

    def __init__(self, plant: GeneralizedPlant, Cy: np.ndarray, seed: int) -> None:
        rng = np.random.default_rng([5, seed])
        self.x, self.u, self.y = (2.0 ** rng.integers(-16, 17, k) for k in (len(plant.A), plant.B.shape[1], len(Cy)))
        w, z, self.t = 2.0 ** rng.integers(-10, 11, 3)
        x = self.x
        self.norm, each = w * z, self.t / x[:, None]
        self.plant = GeneralizedPlant(
            each * plant.A * x,
            each * plant.B * self.u,
            w * each * plant.Bw,
            z * plant.C * x,
            z * plant.D * self.u,
            w * z * plant.Dw,
        )
        self.Cy = Cy * x * self.y[:, None]

    def back(self, gain: np.ndarray) -> np.ndarray:
        """A gain of this plant as one of the given plant."""
        return gain * self.u[:, None] * self.y


def refuse_units(seed: int, times: int) -> None:
    """Fails if a design of a plant is another one in other units."""
    plant, Cy = any_plant(seed)
    for design in (two_step_design, lambda plant, Cy: zero_l_design(plant.measured(Cy))):
        here = _outcome(lambda plant=plant, Cy=Cy, design=design: design(plant, Cy))
        for again in range(times):
            moved = Moved(plant, Cy, 1000 * seed + again)
            there = _outcome(lambda moved=moved, design=design: design(moved.plant, moved.Cy))
            if isinstance(here, str) or isinstance(there, str):
                assert here == there, seed
                continue
            norm, other = here.certificate.norm.value, there.certificate.norm.value / moved.norm
            # Nothing is rounded in units that are powers of two, but in the norm, which is SEEN to 1e-9.
            assert norm == pytest.approx(other, rel=1e-9), seed
            np.testing.assert_allclose(moved.back(there.gain), here.gain, rtol=1e-12, err_msg=str(seed))
            gaps = (there.state_step_gap, there.optimum_gap)
            assert (here.state_step_gap, here.optimum_gap) == pytest.approx(gaps, rel=1e-9, abs=1e-12), seed
            assert here.certificate.speed_up == pytest.approx(there.certificate.speed_up, rel=1e-9), seed


def _outcome(design) -> "DesignResult | str":
    try:
        return design()
    except InputError as error:
        return type(error).__name__


@pytest.mark.parametrize("seed", [3, 270, *attacks((17, 25))])  # this one has A = 0, and no time of its own but through z
def test_a_design_is_the_same_in_any_units(seed):
    """In units of states, forces, measurements, w, z and time that are powers of two a design is the same to the last bits."""
    refuse_units(seed, 1)


@pytest.mark.attack
def test_a_design_is_the_same_in_any_units_by_the_dozen():
    """So are those of a dozen more."""
    for seed in range(100, 112):
        refuse_units(seed, 2)


def test_integrators_are_as_fast_as_z_asks():
    """A plant whose poles all lie at 0 has a rate: of a double integrator that of position over force; in any units."""
    for position, force in ((1.0, 1.0), (100.0, 1e-2), (3.0, 5e-7)):
        plant = GeneralizedPlant(
            np.array([[0.0, 1.0], [0.0, 0.0]]),
            np.array([[0.0], [1.0]]),
            np.array([[0.0], [1.0]]),
            np.array([[position, 0.0], [0.0, 0.0]]),
            np.array([[0.0], [force]]),
            np.zeros((2, 1)),
        )
        rate, moves = speed(plant)
        assert not moves
        assert rate == pytest.approx((position / force) ** 0.5, rel=1e-9)  # least squares without a residual
        for seed in range(3):
            moved = Moved(plant, np.eye(2), seed)
            assert speed(moved.plant) == (pytest.approx(rate * moved.t, rel=1e-9), False)
        mixed = plant.in_coordinates(np.array([[1.0, 0.3], [-0.7, 0.9]]))
        assert not speed(mixed)[1]  # to rounding
        design = two_step_design(plant, np.eye(2))
        assert design.certificate.speed_up < 100
        fast = state_design(plant).certificate
        assert not fast.moves
    assert speed(any_plant(0)[0])[1]


def outcomes(plant: GeneralizedPlant, Cy: np.ndarray, unit: float) -> list[float | str]:
    """The norms of both designs in the first plant's units, or the kind of error."""
    found: list[float | str] = []
    for design in (lambda: state_design(plant), lambda: two_step_design(plant, Cy)):
        try:
            found.append(design().certificate.norm.value / unit)
        except DesignError as error:
            found.append(f"{type(error).__name__}: {str(error)[:40]}")
    return found


@pytest.mark.attack
@pytest.mark.parametrize("seed", [0, *attacks(range(1, 5))])
def test_units_change_neither_verdict_nor_norm(seed):
    """Both designs of random plants, or why there is none, are the same in units up to ten orders of magnitude apart."""
    plant, Cy = a_plant(seed)
    here = outcomes(plant, Cy, 1.0)
    there = outcomes(*in_other_units(plant, Cy, 100 * seed))
    for one, other in zip(here, there, strict=True):
        assert one == (pytest.approx(other, rel=1e-6) if isinstance(other, float) else other)  # AT_REST, where gains grow


@pytest.mark.attack
def test_what_z_does_not_see_is_the_same_in_any_units():
    """If a force can keep states out of z, how these follow the others has no unit: the two steps end at the same norm.

    That of COMPleib's HE1 was anywhere from 0.16 to 0.40.
    """
    plant = GeneralizedPlant(  # HE1, a helicopter
        np.array(
            [
                [-0.0366, 0.0271, 0.0188, -0.4555],
                [0.0482, -1.01, 0.0024, -4.0208],
                [0.1002, 0.3681, -0.707, 1.42],
                [0.0, 0.0, 1.0, 0.0],
            ]
        ),
        np.array([[0.4422, 0.1761], [3.5446, -7.5922], [-5.52, 4.49], [0.0, 0.0]]),
        np.array([[0.0468, 0.0], [0.0457, 0.0099], [0.0437, 0.0011], [-0.0218, 0.0]]),
        np.array([[2**0.5, 0.0, 0.0, 0.0], [0.0, 0.5**0.5, 0.0, 0.0]]),
        0.5**0.5 * np.eye(2),
        np.zeros((2, 2)),
    )
    Cy = np.array([[0.0, 1.0, 0.0, 0.0]])
    here = two_step_design(plant, Cy).certificate.norm.value
    for seed in range(2):
        moved, Cy_moved, unit = in_other_units(plant, Cy, seed)
        there = two_step_design(moved, Cy_moved).certificate.norm.value / unit
        assert there == pytest.approx(here, rel=1e-5)  # the share of X that nothing drives, UNDRIVEN, and AT_REST
    for seed in (6, 16, 21):  # others of which every state can be kept out of z, beside which a problem is posed
        plant, Cy = any_plant(seed)
        here = outcomes(plant, Cy, 1.0)
        there = outcomes(*in_other_units(plant, Cy, seed))
        for one, other in zip(here, there, strict=True):
            assert one == (pytest.approx(other, rel=1e-5) if isinstance(other, float) else other)


def test_a_force_that_costs_nothing_is_named_in_any_units():
    """z weighs no force: that is said, whatever the units."""
    plant = GeneralizedPlant(
        np.array([[0.3, 1.0], [-1.0, 0.2]]),
        np.eye(2),
        np.ones((2, 1)),
        np.array([[1.0, 0.5]]),
        np.zeros((1, 2)),
        np.zeros((1, 1)),
    )
    for seed in range(4):
        moved, Cy, _ = in_other_units(plant, np.eye(2)[:1], seed)
        for design in (lambda p=moved: state_design(p), lambda p=moved, y=Cy: two_step_design(p, y)):
            with pytest.raises(DesignError, match="z weights only"):
                design()


def test_more_forces_than_the_problem_has_entries(capfd):
    """If z weighs one of so many forces that (22) has more unknowns than entries, that is said, and LAPACK prints nothing."""
    rng = np.random.default_rng(1)
    for n, m in ((2, 3), (3, 4), (3, 5)):
        A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((1, n))
        plant = GeneralizedPlant(A, B, np.ones((n, 1)), C, rng.standard_normal((1, m)), np.zeros((1, 1)))
        with pytest.raises(DesignError, match="z weights only"):
            state_design(plant)
    printed = capfd.readouterr()
    assert printed.out + printed.err == ""


def test_a_path_rests_at_the_same_points_in_any_units():
    """From one on mu over eta is a power of ten, and the gamma there is the same."""
    plant, Cy = a_plant(3)
    moved, _, unit = in_other_units(plant, Cy, 1)
    here, there = state_path(plant), state_path(moved)
    assert [point.mu for point in here] == [point.mu for point in there] == [1.0, 0.1, 1e-2, 1e-3, 1e-5, 1e-7, 1e-9]
    for one, other in zip(here, there, strict=True):
        # Where the path is followed by Newton's method to a decrement, which is eta's error over mu; and rounding.
        assert other.gamma / unit == pytest.approx(one.gamma, rel=CENTRE_DECREMENT * one.mu + 1e-10)


def test_own_units_are_no_units():
    """A plant in its own units is nearly the same whatever units it came in, and on the way there and back nothing is rounded."""
    plant, Cy = a_plant(1)
    for seed in range(5):
        moved, Cy_moved, _ = in_other_units(plant, Cy, seed)
        own = own_units(moved.measured(Cy_moved), measured=True)
        for name in ("A", "B", "Bw", "C", "D"):
            np.testing.assert_array_equal(getattr(own.back(own.into(moved)), name), getattr(moved, name))
        # Each unit is a power of two: what is left of ten orders of magnitude is a factor of two each way.
        ratio = np.abs(own.into(moved).A / own_units(plant.measured(Cy), measured=True).into(plant).A)
        assert ratio.max() / ratio.min() < 4.01**2
    # Where all units are open, that of the disturbance stays: an input of an extreme unit moves no other, on any machine.
    for weak in 10.0 ** np.arange(-300, 50, 49):
        one, none = np.eye(2), np.zeros((2, 2))
        plant = GeneralizedPlant(np.diag([-1, -2]), np.diag([1, weak]), one, one, none, none)
        own = own_units(plant)
        np.testing.assert_array_equal(own.states, [1, 1])
        assert own.inputs[1] * weak == pytest.approx(1, rel=0.5)


def test_no_unit_is_a_tie():
    """For a plant whose entries are powers of two, own units lie half-way between two of these: rounding does not choose."""
    A, one = np.array([[-1.0, 2.0], [1.0, -1.0]]), np.eye(2)[:, :1]  # the unit of x2 is 2^-0.5 of that of x1
    plant = GeneralizedPlant(A, one, one, one.T, np.zeros((1, 1)), np.zeros((1, 1)))
    units = own_units(plant)
    for seed in range(20):
        moved = Moved(plant, np.eye(2), seed)
        there = own_units(moved.plant)
        np.testing.assert_array_equal(there.into(moved.plant).A, moved.t * units.into(plant).A)
