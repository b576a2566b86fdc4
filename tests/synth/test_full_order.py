"""Full-order controllers: within 0.1 % of what no controller beats, certified, the same in all units; or they say why not."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from models.laws.linear import LinearLaw, static_law
from models.vehicle.vehicle import read_vehicle
from synth.analysis.certificate import FASTEST
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable, stability
from synth.controller.problem import generalized_plant
from synth.design.full_order.full_order import full_order_design
from synth.design.full_order.quadratic import h2_design, lqg_design
from synth.design.full_order.riccati import SAME, WITHIN, central_law
from synth.design.problem import DesignResult
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError
from synth.plant.units import speed
from tests.claims.test_no_controller_beats_a_bound import KINDS, a_plant
from tests.models.test_units import Moved, any_plant, in_other_units
from tests.support.active_suspension import PRINTED, SCENARIOS, active_suspension
from tests.support.commands import attacks, in_the_suite
from tests.support.shared import made


def loop_by_hand(plant: GeneralizedPlant, Cy: np.ndarray, law: LinearLaw, Dyw: np.ndarray) -> GeneralizedPlant:
    """The closed loop written out, by another route than the larger plant's: u = D_c y + C_c x_c put into x' and z."""
    A = np.block([[plant.A + plant.B @ law.D @ Cy, plant.B @ law.C], [law.B @ Cy, law.A]])
    Bw = np.vstack([plant.Bw + plant.B @ law.D @ Dyw, law.B @ Dyw])
    C = np.hstack([plant.C + plant.D @ law.D @ Cy, plant.D @ law.C])
    return GeneralizedPlant(A, np.zeros((len(A), 1)), Bw, C, np.zeros((len(C), 1)), plant.Dw + plant.D @ law.D @ Dyw)


def holds(plant: GeneralizedPlant, Cy: np.ndarray, found: DesignResult, Dyw: np.ndarray | None = None) -> None:
    """Everything that is claimed of a design, from its law alone."""
    loop = loop_by_hand(plant, Cy, found.law, np.zeros((len(Cy), plant.Bw.shape[1])) if Dyw is None else Dyw)
    certificate = found.certificate
    assert np.all(np.linalg.eigvals(loop.A).real < 0)
    norm = hinf_norm(loop)
    # Laws with large entries lose digits where the loop is formed by floats alone: as many as its last bits, shaken, take away.
    signs = np.random.default_rng(20261122).choice([-1.0, 1.0], (4, *loop.A.shape))
    shaken = [hinf_norm(replace(loop, A=loop.A * (1 + np.finfo(float).eps * each))).value / norm.value - 1 for each in signs]
    lost = 10 * max(norm.rounding, *np.abs(shaken))
    assert norm.value == pytest.approx(certificate.norm.value, rel=max(1e-7, lost))
    if certificate.lower_bound is not None:
        assert certificate.lower_bound * (1 - 1e-9) <= certificate.norm.value  # rounding of the norm
    if certificate.bound is not None:
        assert certificate.norm.value <= certificate.bound
    assert not certificate.failures
    assert found.stable == is_stable(found.law.A)
    assert bool(found.remark) == (certificate.gap is None or certificate.gap > WITHIN or certificate.beyond_actuators)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("quarter_car", "I"),
        ("half_car", "I"),
        *(pytest.param(kind, "II", marks=pytest.mark.attack) for kind in ("quarter_car", "half_car")),
    ],
)
def test_cars(kind, name):
    """From what I and II measure the norm is within 0.1 % of what no controller beats, with poles of the plant's speed."""
    vehicle = read_vehicle(kind)
    plant, Cy = generalized_plant(vehicle), vehicle.linear_model.rows(vehicle.controllers[name].measured)[0]
    found = full_order_design(plant, Cy)
    holds(plant, Cy, found)
    assert found.certificate.gap is not None
    assert found.certificate.gap < WITHIN
    assert found.certificate.speed_up < 5
    assert found.stable
    assert not found.remark
    assert not found.trade
    if kind == "quarter_car":
        assert found.certificate.norm.value < 7.8443  # 7.836458, given with that many digits, and 0.1 %
        assert found.certificate.lower_bound == pytest.approx(7.836458, abs=1e-6)


@pytest.mark.attack
@pytest.mark.parametrize("name", ["I", "II"])
def test_full_car_with_its_twist(name):
    """So is the full car's, on the road's velocities and its twist: 14 states, 4 forces, 5 disturbances."""
    vehicle = read_vehicle("full_car")
    plant, Cy = generalized_plant(vehicle), vehicle.linear_model.rows(vehicle.controllers[name].measured)[0]
    assert plant.Bw.shape == (14, 5)
    found = full_order_design(plant, Cy)
    holds(plant, Cy, found)
    assert found.certificate.gap is not None
    assert found.certificate.gap < WITHIN
    assert not found.certificate.beyond_actuators


@pytest.mark.parametrize("scenario", in_the_suite((0.5,), SCENARIOS))
def test_active_suspension(scenario):
    """The three scenarios of MathWorks' example, with weights over frequency and noise on both measurements: as printed."""
    plant = active_suspension(scenario)
    found = full_order_design(plant)
    holds(plant, plant.Cy, found, plant.Dyw)
    printed, by_lmi = PRINTED[scenario]
    assert round(found.certificate.norm.value, 2) == pytest.approx(printed)
    assert found.certificate.lower_bound == pytest.approx(by_lmi, abs=5e-6)  # given with 5 digits
    assert found.certificate.gap is not None
    assert found.certificate.gap < WITHIN


# Of the other kinds some optima take gains that rounding does not leave: there the remark says how far above the bound it is.
SHARP = ("undamped", "rank-deficient D", "feedthrough", "uncontrollable", "free inputs")


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        *((kind, 0) for kind in SHARP[:2]),
        *(pytest.param(kind, 0, marks=pytest.mark.attack) for kind in SHARP[2:]),
        *(pytest.param(kind, 4, marks=pytest.mark.attack) for kind in SHARP),
    ],
)
def test_random_plants(kind, seed):
    """On random plants, singular as they are, it comes within 0.1 % of the lower bound where poles may be as fast as it takes."""
    plant, Cy = a_plant(kind, seed)
    found = full_order_design(plant, Cy, fastest=np.inf)
    holds(plant, Cy, found)
    assert found.certificate.gap is not None
    assert found.certificate.gap < WITHIN


def designed(plant: GeneralizedPlant, Cy: np.ndarray) -> DesignResult:
    return full_order_design(plant, Cy)


# Plants whose best laws are fast: A, B, Bw, rows of z beside forces, C_y, the cost of a force, and what SLICOT's hinfsyn reaches.
FAST = (
    "-.19 1.8 .19 1.4 1.1 -2.8 .34 .8; .15 1.6 .92 .39 1.7 -.96 -1.9 -.93; 1.2 -.021 2 -.013 -.63 .91 -1.6 -1.2;"
    ".5 -.98 -.28 .088 .38 .94 -.37 2; .93 -1 .99 .55 .45 1.3 .85 -.13; 1.4 -.23 -2.7 -.055 .16 .98 .25 -.84;"
    "2.7 -1 -.13 -.59 .095 .79 .88 -1.5; 1.1 -.29 .59 1.1 .79 -.37 .84 1.6",
    ".99 -1.3 -.66; -.79 .48 .7; 2.4 1.8 -.57; -1.4 -.69 .37; -.98 .009 -.13; .21 -.2 .75; 1.5 1.8 -.55; .65 1.8 2",
    ".24; -.64; .49; -.88; -.88; .5; -.95; .2",
    "-1.2 .16 -1.4 -1.6 .86 -.29 1.3 -.15",
    "-.41 .32 .5 1.5 -.72 -.57 .5 -1.1; 1.3 -.41 .67 .71 1.2 -1.3 .38 1.8",
    0.012,
    0.0445,
)
FASTER = (
    "0 1; -.0595 0",
    "-.0526 -.551; .0649 2.06",
    "-1.68 -1.54; -.681 1.13",
    ".266 -.863; .0566 -1.42; -1.22 -.772",
    ".518 -.315",
    0.0102,
    5.527,
)


def fast_plant(*texts: str, cost: float) -> tuple[GeneralizedPlant, np.ndarray]:
    """The plant of one of these."""
    A, B, Bw, z, Cy = (np.array([row.split() for row in text.split(";")], dtype=float) for text in texts)
    (d, n), m = z.shape, B.shape[1]
    C, D = np.vstack([z, np.zeros((m, n))]), np.vstack([np.zeros((d, m)), cost * np.eye(m)])
    return GeneralizedPlant(A, B, Bw, C, D, np.zeros((d + m, Bw.shape[1]))), Cy


@pytest.mark.attack
@pytest.mark.parametrize("case", [FAST, FASTER], ids=["fast", "faster"])
def test_the_best_law_is_taken_however_fast(case):
    """The norm is that of SLICOT's hinfsyn or better, next to the lower bound, and the remark says how fast that is: too fast."""
    *texts, cost, slicot = case
    plant, Cy = fast_plant(*texts, cost=cost)
    found = full_order_design(plant, Cy)
    holds(plant, Cy, found)
    assert found.certificate.norm.value <= slicot
    assert found.certificate.gap is not None
    assert found.certificate.gap < WITHIN
    pole = np.abs(np.linalg.eigvals(found.certificate.loop.A)).max()
    assert found.certificate.beyond_actuators
    said = re.search(
        r"fastest pole is (\S+) rad/s, .* sample period of (\S+) s or more .*; fastest_pole = (\S+) gives .* norm (\S+)$",
        found.remark,
    )
    assert said is not None
    there, period, slower, norm = (float(each) for each in said.groups())
    assert there == pytest.approx(pole, rel=5e-3)  # three digits
    assert period * pole == pytest.approx(1.0, rel=0.5)  # one digit
    if case is FASTER:  # the other takes as long again
        limited = full_order_design(plant, Cy, fastest_pole=slower)
        assert np.abs(np.linalg.eigvals(limited.certificate.loop.A)).max() <= slower
        assert limited.certificate.norm.value <= norm * (1 + WITHIN)  # as near as what is next to the best


@pytest.mark.attack
def test_faster_laws_are_nearer():
    """The loop keeps `fastest_pole`, and a larger one costs no norm."""
    for case in (FAST, FASTER):
        plant, Cy = fast_plant(*case[:5], cost=case[5])
        norms = []
        for limit in (20.0, 200.0, 2000.0):
            found = full_order_design(plant, Cy, fastest_pole=limit)
            holds(plant, Cy, found)
            assert np.abs(np.linalg.eigvals(found.certificate.loop.A)).max() <= limit
            norms.append(found.certificate.norm.value)
        assert norms == sorted(norms, reverse=True)


@pytest.mark.attack
def test_a_limit_that_no_law_keeps():
    """A `fastest_pole` that no law keeps is refused with the slowest there is, and so is any for a discrete plant."""
    plant, Cy = fast_plant(*FASTER[:5], cost=FASTER[5])
    with pytest.raises(
        DesignError, match=r"within fastest_pole = 0\.01 rad/s; the slowest loop found needs fastest_pole = \S+: give"
    ):
        full_order_design(plant, Cy, fastest_pole=0.01)
    sampled = replace(plant, A=np.eye(2) + 0.01 * plant.A, B=0.01 * plant.B, Bw=0.01 * plant.Bw, dt=0.01)
    with pytest.raises(InputError, match="omit fastest_pole"):
        full_order_design(sampled, Cy, fastest_pole=20.0)


@pytest.mark.attack
@pytest.mark.parametrize("seed", [2])
def test_a_trade(seed):
    """The front is one: norms fall as speeds grow, and a limit at any of its speeds comes to its norm."""
    plant, Cy = any_plant(seed)
    found = made(designed, plant, Cy)
    holds(plant, Cy, found)
    speeds, norms = [each.speed_up for each in found.trade], [each.norm for each in found.trade]
    assert speeds == sorted(speeds)
    assert norms == sorted(norms, reverse=True)
    for each in found.trade[:: max(1, len(speeds) // 3)]:
        best = full_order_design(plant, Cy, fastest=1.1 * each.speed_up)
        assert best.certificate.norm.value <= each.norm * 1.0011  # as near as what is next to the best, and rounding


@pytest.mark.parametrize("seed", in_the_suite((3,), range(8)))
def test_central_law(seed):
    """A law for gamma has a norm below it, with feed-through from w to z, and none is refused far above what is reached."""
    rng = np.random.default_rng(seed)
    n, m, q, r, d = int(rng.integers(1, 6)), 1 + seed % 2, 1 + seed // 4, 4, 4
    A, B, Bw, C, D = (rng.standard_normal(shape) for shape in ((n, n), (n, m), (n, r), (d, n), (d, m)))
    small = 0.02 if seed % 4 > 1 else 1.0  # then what is fed through decides
    plant = GeneralizedPlant(A - (seed % 3) * np.eye(n), B, small * Bw, small * C, D, rng.standard_normal((d, r)))
    Cy, Dyw = rng.standard_normal((q, n)), rng.standard_normal((q, r))
    reached, refused = [], []

    def tried(gammas: np.ndarray) -> None:
        for gamma in gammas:
            try:
                law = central_law(plant.measured(Cy, Dyw), gamma)
            except InfeasibleError:
                refused.append(gamma)
                continue
            loop = loop_by_hand(plant, Cy, law, Dyw)
            assert np.all(np.linalg.eigvals(loop.A).real < 0)
            norm = hinf_norm(loop).value
            assert norm < gamma
            reached.append(norm)

    apart = 1.26
    tried(np.geomspace(0.2, 2e5, 60))  # as far apart as that
    tried(max(refused) * np.geomspace(1, apart, 7)[1:-1])
    assert reached
    assert max(refused) < min(reached) * 1.05  # the step of gamma: it is refused only where it cannot be reached


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(1, 4))
def test_units(seed):
    """In units of states, forces, measurements, w, z, time that differ by powers of two the law is the same to the last bit."""
    plant, Cy = any_plant(seed) if seed % 2 else a_plant("free inputs", seed)
    moved = Moved(plant, Cy, seed)
    one, other = made(designed, plant, Cy).law, full_order_design(moved.plant, moved.Cy).law
    # The unit of the states as a whole is left open.
    np.testing.assert_array_equal(other.A / moved.t, one.A)
    np.testing.assert_array_equal(moved.u[:, None] * other.D * moved.y, one.D)
    through = [np.einsum("mk,kq->kmq", law.C, law.B) for law in (one, other)]
    np.testing.assert_array_equal(moved.u[:, None] / moved.t * through[1] * moved.y, through[0])


@pytest.mark.attack
def test_redundant_measurements():
    """A signal that follows from others is left alone where it is free of noise; with noise of its own it helps."""
    plant = GeneralizedPlant(
        np.array([[0.0, 1], [-4, -0.1]]),
        np.array([[0.0], [1]]),
        np.array([[0.0], [1]]),
        np.array([[1.0, 0], [0, 0]]),
        np.array([[0.0], [0.1]]),
        np.zeros((2, 1)),
    )
    Cy = np.array([[0.0, 1.0]])
    twice = np.vstack([Cy, 2 * Cy[:1]])
    found = full_order_design(plant, twice)
    assert not np.any(found.law.B[:, len(Cy) :])
    assert found.certificate.norm.value == pytest.approx(full_order_design(plant, Cy).certificate.norm.value, rel=WITHIN)
    q, r, n = len(Cy), plant.Bw.shape[1], len(plant.A)
    noisy = replace(plant, Bw=np.hstack([plant.Bw, np.zeros((n, q + 1))]), Dw=np.zeros((len(plant.C), r + q + 1)))
    noise = np.hstack([np.zeros((q + 1, r)), np.diag([3.0] * q + [6.0])])
    both, one = full_order_design(noisy, twice, noise), full_order_design(noisy, Cy, noise[:q])
    holds(noisy, twice, both, noise)
    assert np.any(both.law.B[:, q:])
    assert both.certificate.norm.value < one.certificate.norm.value * (1 - 1e-3)


def test_disturbance_of_measurements_alone():
    """If w acts on y alone and z is u, the least norm is 2 p / |r|, from the residue r of the unstable pole p (Glover 1986)."""
    A, B, Cy = np.array([[0.0, 1, 0], [2, -1, 1], [0, 0, -3]]), np.array([[0.0], [1], [1]]), np.array([[1.0, 0, 0]])
    plant = GeneralizedPlant(A, B, 0 * B, 0 * Cy, np.eye(1), np.zeros((1, 1)), Cy=Cy, Dyw=np.eye(1))
    pole, near = 1.0, 1e-6  # distance to the pole, and error of the residue
    residue = near * (Cy @ np.linalg.solve((pole + near) * np.eye(3) - A, B)).item()
    found = full_order_design(plant)
    assert found.certificate.norm.value == pytest.approx(2 * pole / abs(residue), rel=WITHIN)
    holds(plant, Cy, found, plant.Dyw)
    X, Y = (linalg.solve_continuous_are(*pair, np.zeros((3, 3)), np.eye(1)) for pair in ((A, B), (A.T, Cy.T)))
    mean = float(np.sqrt(B.T @ X @ Y @ X @ B).item())  # of u = -B' X x_c alone: w does not reach the state
    silent = plant.measured(Cy)
    for design in (h2_design(plant), lqg_design(silent, noise=[1.0])):
        assert design.h2_norm == pytest.approx(mean, rel=1e-9)  # of two Riccati equations


def test_what_cannot_be_designed():
    """A line names the mode that is not reached or not seen, or what is missing from the plant."""
    plant, Cy = a_plant("undamped", 0)
    names = [*(f"s{i}" for i in range(len(plant.A))), "lost"]
    force, seen = (np.ones((size, 1)) for size in (plant.B.shape[1], len(Cy)))
    wide = GeneralizedPlant(
        np.asarray(linalg.block_diag(plant.A, [[0.5]])), np.vstack([plant.B, force.T]), np.vstack([plant.Bw, plant.Bw[:1]]),
        np.hstack([plant.C, np.ones((len(plant.C), 1))]), plant.D, plant.Dw,
    )  # fmt: skip
    still = replace(wide, B=np.vstack([plant.B, 0 * force.T]))
    for found, rows, message in (
        (still, np.hstack([Cy, seen]), r"no input acts on the mode at 0\.5 1/s.*most in lost"),
        (wide, np.hstack([Cy, 0 * seen]), r"none of them contains the mode at 0\.5 1/s.*most in lost"),
        (replace(plant, Bw=0 * plant.Bw, Dw=0 * plant.Dw), Cy, "no disturbance"),
        (replace(plant, C=0 * plant.C, D=0 * plant.D), Cy, "controlled output z is always zero"),
        (plant, 0 * Cy, "row 0 of Cy is zero"),
    ):
        with pytest.raises(InputError, match=message):
            full_order_design(found, rows, states=names[: len(found.A)])


@pytest.mark.attack
@pytest.mark.parametrize("kind", [*KINDS, "any", "other units"])
def test_hostile_plants(kind):
    """Of every kind of plant, in any units, every claim holds, or one line says why there is no controller; never a traceback."""
    said = list[str]()
    for seed in range(20, 23):
        if kind in ("any", "other units"):
            plant, Cy = any_plant(seed)
            if kind == "other units":
                plant, Cy, _ = in_other_units(plant, Cy, seed)
        else:
            plant, Cy = a_plant(kind, seed)
        try:
            found = full_order_design(plant, Cy)
        except DesignError as error:
            said.append(str(error))
            continue
        holds(plant, Cy, found)
        break
    else:
        pytest.fail("none has a controller")
    assert not any("\n" in line for line in said)


@pytest.mark.attack
def test_idle_states_of_a_design():
    """A mode that is undriven, unseen and decays by itself is no part of the controller; the norm is as without it."""
    plant, Cy = a_plant("undamped", 4)
    n = len(plant.A)
    beside = GeneralizedPlant(
        np.asarray(linalg.block_diag(plant.A, [[-1.0]])), np.vstack([plant.B, 0 * plant.B[:1]]),
        np.vstack([plant.Bw, 0 * plant.Bw[:1]]), np.hstack([plant.C, 0 * plant.C[:, :1]]), plant.D, plant.Dw,
    )  # fmt: skip
    short, longer = full_order_design(plant, Cy), full_order_design(beside, np.hstack([Cy, 0 * Cy[:, :1]]))
    assert short.law.states == n
    assert longer.law.states == n
    assert longer.certificate.norm.value == pytest.approx(short.certificate.norm.value, rel=WITHIN + SAME)  # both within 0.1 %


# --- a static gain is one of full order, too --------------------------------------------------------------------------------


GRID = np.concatenate([-np.logspace(-3, 3, 60), [0.0], np.logspace(-3, 3, 60)])
BEATEN = 2e-3  # relative; full order ends within 0.1 % of the best it can follow, and rounds as much again on the way


def best_on_the_grid(plant: GeneralizedPlant, Cy: np.ndarray, Dyw: np.ndarray) -> float:
    """The smallest norm of the grid's static gains whose loops are stable, and not faster than what full order may be."""
    norms, own = [np.inf], speed(plant)[0]
    for K in GRID:
        loop = plant.measured(Cy, Dyw).closed(static_law(np.array([[K]])))
        if stability(loop.A, loop.dt).stable and np.abs(np.linalg.eigvals(loop.differences.A)).max() <= FASTEST * own:
            norms.append(hinf_norm(loop).value)
    return min(norms)


def first_order(a: float, noise: float, dt: float | None = 1.0) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """x' (or x+) = a x + u + w, z = [x; 0.1 u], y = x + noise v."""
    A, one = np.array([[a]]), np.eye(1)
    plant = GeneralizedPlant(
        A, one, np.array([[1.0, 0]]), np.array([[1.0], [0]]), np.array([[0], [0.1]]), np.zeros((2, 2)), dt=dt
    )
    return plant, one, np.array([[0, noise]])


def any_noisy(seed: int, dt: float | None) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """A random plant of one to three states with one noisy measurement, stable or not, and a force that costs something."""
    rng = np.random.default_rng([17, seed])
    n = int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    if dt is not None:
        A *= rng.uniform(0.3, 1.2) / np.abs(np.linalg.eigvals(A)).max()
    Bw = np.hstack([rng.standard_normal((n, 1)), np.zeros((n, 1))])
    C, D = np.vstack([rng.standard_normal((1, n)), np.zeros((1, n))]), np.array([[0.0], [10 ** rng.uniform(-2, 0)]])
    plant = GeneralizedPlant(A, rng.standard_normal((n, 1)), Bw, C, D, np.zeros((2, 2)), dt=dt)
    return plant, rng.standard_normal((1, n)), np.array([[0, 10 ** rng.uniform(-2, 0)]])


def assert_bounded(found: DesignResult) -> None:
    """The certificate of a design holds, of a discrete plant too, and a remark is made where the lower bound is not reached."""
    assert not found.certificate.failures
    assert found.certificate.lower_bound is not None
    assert found.certificate.lower_bound <= found.certificate.norm.value
    assert ("above" in found.remark) == (found.certificate.norm.value > found.certificate.lower_bound * (1 + WITHIN))


def no_grid_beats(plant: GeneralizedPlant, Cy: np.ndarray, Dyw: np.ndarray) -> DesignResult:
    """Checks what the tests below claim, and returns the design that it is claimed of."""
    found = full_order_design(plant, Cy, Dyw)
    assert_bounded(found)
    assert found.certificate.norm.value <= best_on_the_grid(plant, Cy, Dyw) * (1 + BEATEN)
    return found


@pytest.mark.parametrize(("a", "dt"), [(0.5, 1.0), *attacks([(-0.5, None)])])
def test_static_gain_next_to_the_bound(a, dt):
    """If the central law needs a pole a thousand times as fast, what is left of it without that pole is as near, and taken."""
    found = no_grid_beats(*first_order(a, 0.1, dt))
    assert found.remark == ""
    assert found.certificate.speed_up < FASTEST


@pytest.mark.parametrize(("seed", "dt"), [(1, None), *attacks([(12, None), (2, 0.1), (100, None), (101, 0.1)])])
def test_no_static_gain_is_better(seed, dt):
    """For random plants no static gain of a grid beats full order by more than 0.2 %."""
    no_grid_beats(*any_noisy(seed, dt))


@pytest.mark.parametrize(("side", "distance"), [(-1, 1e-13), *attacks([(1, 0.0), (-1, 0.0), (-1, 1e-6), (1, 1e-8)])])
def test_poles_next_to_the_unit_circle_at_real_points(side, distance):
    """With a pole next to z = -1, where the map has no place for it, or next to 1 a law is as near as the best static gain."""
    found = full_order_design(*first_order(side * (1 - distance), 0.0))
    assert_bounded(found)
    assert found.certificate.norm.value <= 1.00499 * (1 + BEATEN)  # what a grid's best static gain has of each
