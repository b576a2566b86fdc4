"""Redesigning for many vehicles: the same controllers as one by one, whatever the company."""

import dataclasses

import numpy as np
import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from synth.controller.problem import generalized_plant
from synth.design.batch import two_step_designs
from synth.design.two_step import two_step_design
from synth.lmi.barrier import Barrier, newton
from synth.lmi.central_path import central_path
from synth.lmi.central_path_batch import cholesky, inverse, minimise, path_limits
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import BatchError
from synth.vehicle.designer import Designer
from tests.conftest import plant_with_feedthrough, random_vehicles


@pytest.mark.parametrize(
    ("kind", "name", "count"),
    [
        ("quarter_car", "I", 5),
        ("quarter_car", "state", 5),
        ("quarter_car", "II", 5),
        ("half_car", "I", 2),
        pytest.param("half_car", "I", 20, marks=pytest.mark.attack),
        pytest.param("half_car", "II", 5, marks=pytest.mark.attack),
    ],
)
def test_same_as_one_by_one(kind, name, count):
    """Parameters +-30 %: gains, norms and bounds are those of `design`, in the vehicles' order, and every certificate holds."""
    vehicle = read_vehicle(kind)
    vehicles = random_vehicles(vehicle, count, 0.3)
    controllers = Designer(vehicle).redesign(vehicles, name)
    assert len(controllers) == count
    for controller, each in zip(controllers, vehicles, strict=True):
        alone = Designer(each).design(name)
        assert controller.certificate.failures == ()
        # Both stop at mu = LIMIT eta, up to rounding: 1e-8 of a quarter-car's gain, 3e-6 of a half-car's smallest entries.
        np.testing.assert_allclose(controller.gain, alone.gain, rtol=1e-6 if kind == "quarter_car" else 1e-5)
        assert controller.certificate.bound == pytest.approx(alone.certificate.bound, rel=1e-9)  # rounding of eta
        assert controller.certificate.norm.value == pytest.approx(alone.certificate.norm.value, rel=1e-8)
        assert (controller.name, controller.measured, controller.designed) == (alone.name, alone.measured, True)
        assert (controller.state_step_gap, controller.optimum_gap) == (alone.state_step_gap, alone.optimum_gap)


def near(plant: GeneralizedPlant, count: int, seed: int = 0) -> list[GeneralizedPlant]:
    """Plants whose every entry is within 5 % of that of a plant."""
    rng = np.random.default_rng(seed)
    return [
        GeneralizedPlant(
            *(
                getattr(plant, name) * rng.uniform(0.95, 1.05, getattr(plant, name).shape)
                for name in ("A", "B", "Bw", "C", "D", "Dw")
            )
        )
        for _ in range(count)
    ]


@pytest.mark.parametrize("seed", range(3))
def test_plants_with_feedthrough(seed):
    """Several inputs and disturbances, a D_w, an unstable A: each limit is that of the plant's own central path."""
    nominal = plant_with_feedthrough(seed)
    plants = near(nominal, 4)
    Q, R = np.zeros((4, 5, 0)), np.tile(np.eye(5), (4, 1, 1))
    limits = path_limits(plants, Q, R, central_path(nominal, Q[0], R[0])[0])
    assert sorted(limits) == [0, 1, 2, 3]
    for i, plant in enumerate(plants):
        alone = central_path(plant, Q[i], R[i])[-1]
        assert limits[i].eta == pytest.approx(alone.eta, rel=1e-10)  # measured 2e-12
        np.testing.assert_allclose(limits[i].K, alone.K, rtol=0, atol=2e-6 * np.abs(alone.K).max())  # measured 2e-7
        np.testing.assert_allclose(limits[i].X, alone.X, rtol=0, atol=2e-7 * np.abs(alone.X).max())  # measured 3e-8


def test_company_changes_nothing(designer):
    """A plant that no input stabilises is left out, and the others' limits are those without it."""
    plant = designer.plant
    lost = GeneralizedPlant(plant.A + 100 * np.eye(4), 0 * plant.B, plant.Bw, plant.C, plant.D, plant.Dw)
    plants = near(plant, 3)
    nominal = designer.state_path[0]

    def limits(some):
        return path_limits(some, np.zeros((len(some), 4, 0)), np.tile(np.eye(4), (len(some), 1, 1)), nominal)

    mixed, pure = limits([plants[0], lost, *plants[1:]]), limits(plants)
    assert sorted(mixed) == [0, 2, 3]
    for i, j in ((0, 0), (2, 1), (3, 2)):
        np.testing.assert_allclose(mixed[i].K, pure[j].K, rtol=1e-9)  # the same operations, in stacks of another size
    assert limits([lost]) == limits([]) == {}


def test_redundant_measurements(designer):
    """A signal that follows from the others gets no gain, in many plants as in one."""
    Cy = np.eye(4)[[0, 2]]
    Cy = np.vstack([Cy, Cy[0] - 2 * Cy[1]])
    plants = [generalized_plant(vehicle) for vehicle in random_vehicles(designer.vehicle, 2, 0.3)]
    for plant, design in zip(plants, two_step_designs(designer.plant, designer.state_path, Cy, plants, [Cy, Cy]), strict=True):
        assert design.redundant == (2,)
        np.testing.assert_allclose(design.gain, two_step_design(plant, Cy).gain, rtol=1e-6)


def test_vehicles_that_are_not_alike(designer, paper):
    """A vehicle that weighs other signals, or measures what makes (25) another problem, is designed by itself."""
    other = dataclasses.replace(paper, performance={**paper.performance, "tyre_deflection": 0.0})
    first, second = designer.redesign([paper, other], "I")
    np.testing.assert_allclose(first.gain, designer.design("I").gain, rtol=1e-6)
    np.testing.assert_array_equal(second.gain, Designer(other).design("I").gain)


def test_none():
    """No vehicles, no controllers."""
    assert Designer(read_vehicle("quarter_car")).redesign([], "I") == []


def test_what_cannot_be_designed_is_named(designer, paper):
    """All vehicles without a controller are named by index in one line, with the reason of the first."""
    lost = dataclasses.replace(paper, performance={"sprung_acceleration": 1.0})
    with pytest.raises(BatchError, match=r"controller 'state': 2 of 4 cannot be designed, by index: 1, 3; 1: ") as caught:
        designer.redesign([paper, lost, paper, lost], "state")
    assert "\n" not in str(caught.value)
    assert list(caught.value.designs) == [0, 2]
    assert list(caught.value.failures) == [1, 3]
    for controller in caught.value.designs.values():
        assert (controller.name, controller.certificate.failures) == ("state", ())
        np.testing.assert_allclose(controller.gain, designer.design("state").gain, rtol=1e-6)  # where the path is stopped


def test_one_plant_that_fails_leaves_the_others(designer):
    """A double integrator, a C_y of zeros and one that does not fit: each is named, and the batch keeps its other designs."""
    plant, Cy = designer.plant, np.eye(4)[[0, 2]]
    masses = GeneralizedPlant(
        np.eye(4, k=2), np.eye(4)[:, 2:3], plant.Bw, np.vstack([np.eye(4), np.zeros((1, 4))]), np.eye(5)[:, 4:], np.zeros((5, 1))
    )
    plants = [plant, masses, plant, plant, plant]
    with pytest.raises(BatchError, match="3 of 5 cannot be designed, by index: 1, 2, 3; 1: ") as caught:
        two_step_designs(plant, designer.state_path, Cy, plants, [Cy, Cy[:1], 0 * Cy, np.ones((1, 3)), Cy])
    assert sorted(caught.value.designs) == [0, 4]
    assert "row 0 of Cy is zero" in str(caught.value.failures[2])
    assert "Cy has shape (1, 3)" in str(caught.value.failures[3])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("III", "unknown controller 'III'; this vehicle has I, II,"),
        ("passive", "controller 'passive' has a gain of its own, and it is two steps alone"),
        ("I_printed", "controller 'I_printed' has a gain of its own"),
        (3, "unknown controller '3'; this vehicle has I, II"),
    ],
)
def test_names_that_do_not_fit(designer, paper, name, message):
    """A controller is one of the vehicle's, and one that is designed."""
    with pytest.raises(InputError, match=message):
        designer.redesign([paper], name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda paper: None, "vehicle 1 is None; expected a Vehicle"),
        (lambda paper: changed(paper, sprung_mass=np.nan), "vehicle 1: sprung_mass = nan is not allowed; give a number from"),
        (lambda paper: dataclasses.replace(paper, parameters={}), r"vehicle 1: parameter 'sprung_mass' \[kg\] is missing"),
        (lambda paper: changed(paper, colour=1.0), "vehicle 1: unknown parameter 'colour'"),
        (lambda paper: dataclasses.replace(paper, performance={"colour": 1.0}), "vehicle 1: .* unknown signal 'colour'"),
    ],
    ids=["none", "nan", "missing", "unknown", "weight"],
)
def test_what_is_no_vehicle_is_refused(designer, paper, change, message):
    """Vehicles that `dataclasses.replace` made are checked as files are, and the one at fault is named."""
    with pytest.raises(InputError, match=message) as caught:
        designer.redesign([paper, change(paper)], "I")
    assert "\n" not in str(caught.value)


def test_numbers_of_numpy_are_numbers(designer, paper):
    """A parameter in single precision, or a whole one, is designed for as the same float is."""
    found = designer.redesign([changed(paper, sprung_mass=kind(505)) for kind in (float, np.float32, np.int64)], "I")
    assert all(np.array_equal(one.gain, found[0].gain) for one in found)


def changed(vehicle, **parameters):
    """A vehicle with some parameters of its own."""
    return dataclasses.replace(vehicle, parameters={**vehicle.parameters, **parameters})


def test_another_kind_is_refused(designer, paper):
    """Vehicles are of one kind; the first of another is named."""
    with pytest.raises(InputError, match="vehicle 1 is a half_car; expected quarter_car"):
        designer.redesign([paper, read_vehicle("half_car")], "I")


def test_factors():
    """Cholesky factors and their inverses are LAPACK's; one that does not exist is NaN and disturbs no other."""
    rng = np.random.default_rng(0)
    M = rng.standard_normal((3, 6, 6))
    M = M @ M.swapaxes(1, 2)
    M[1] -= 100 * np.eye(6)
    L = cholesky(M)
    for i in (0, 2):
        np.testing.assert_allclose(L[i], np.linalg.cholesky(M[i]), rtol=1e-9)
        np.testing.assert_allclose(inverse(L)[i], np.linalg.inv(np.linalg.cholesky(M[i])), atol=1e-9)
    assert np.isnan(L[1, -1]).all()


def test_minima():
    """Newton's method side by side ends where it does one by one, from the same starts."""
    rng = np.random.default_rng(1)
    V, N, k = 4, 3, 5
    F = rng.standard_normal((V, N, k, k))
    F = F + F.swapaxes(2, 3)
    F[:, -1] -= 3 * np.eye(k)  # bounded in the direction of the slope
    shared = np.concatenate([F[0, :-1], np.eye(k)[None]])
    slope = -rng.uniform(1, 10, V)
    blocks = [(np.eye(k), F.swapaxes(1, 2)), (np.eye(k), shared.swapaxes(0, 1)[None]), (np.eye(k), -shared.swapaxes(0, 1)[None])]
    together = minimise(blocks, np.zeros((V, N)), slope, np.full(V, 1e-8))
    for i in range(V):
        c = np.array([0, 0, slope[i]])
        p, _, here = newton(Barrier([(np.eye(k), F[i]), (np.eye(k), shared), (np.eye(k), -shared)]), np.zeros(N), c, 1e-8)
        np.testing.assert_allclose(together.p[i], p, atol=1e-12)
        tangent = here.solve(here.half(np.array([0, 0, 1.0])))
        np.testing.assert_allclose(together.tangent[i], tangent, rtol=1e-9)
    assert (together.decrement < 1e-8).all()
