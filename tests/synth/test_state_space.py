"""Controllers come from python-control's systems and go back as such, by the names of their signals; its loops are ours."""

from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest

from models.common.errors import InputError
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import read_vehicle
from synth.vehicle.state_space import closed_loop, controller_from, law_system
from tests.support.weighted import weighted_loop

MEASURED = {
    "velocities": lambda name: "velocity" in name and "road" not in name,
    "accelerations": lambda name: "acceleration" in name or "suspension_deflection" in name,
}


def ss(*parts, **names) -> control.StateSpace:
    """A system of python-control's, whose `ss` may make others too."""
    system = control.ss(*parts, **names)
    assert isinstance(system, control.StateSpace)
    return system


def some_system(vehicle, kind: str, states: int = 3) -> control.StateSpace:
    """A random system with the names of a vehicle's signals, slow and weak enough for the loop to be stable."""
    rng, model = np.random.default_rng(states), vehicle.linear_model
    names = [name for name in model.measurable if MEASURED[kind](name)]
    m, q = len(model.inputs), len(names)
    A = -np.diag(np.geomspace(2, 90, states)) + np.triu(rng.uniform(-2, 2, (states, states)), 1)
    parts = rng.standard_normal((states, q)), 30 * rng.standard_normal((m, states)), 5 * rng.standard_normal((m, q))
    return ss(A, *parts, inputs=names, outputs=list(model.inputs))


@pytest.mark.parametrize("vehicle", ["quarter_car", "half_car"])
@pytest.mark.parametrize("kind", MEASURED)
@pytest.mark.parametrize("states", [0, 3])
def test_the_loop_is_python_controls(vehicle, kind, states):
    """`closed_loop` and `weighted_loop` of a law with states, on accelerations too, are what `control.feedback` makes."""
    car = read_vehicle(vehicle)
    system = some_system(car, kind, states)
    controller = controller_from(car, "mine", system.input_labels, system)
    model, back = car.linear_model, law_system(car, controller)
    D = np.hstack([np.zeros((len(model.C), len(model.disturbances))), model.D])
    inputs = [*model.disturbances, *model.inputs]
    open_loop = ss(model.A, np.hstack([model.Bw, model.B]), model.C, D, inputs=inputs, outputs=list(model.outputs))
    rows = [open_loop.output_labels.index(name) for name in back.input_labels]
    columns = [open_loop.input_labels.index(name) for name in back.output_labels]
    measure, act = np.eye(len(open_loop.output_labels))[rows], np.eye(len(open_loop.input_labels))[:, columns]
    theirs = control.feedback(open_loop, ss(back.A, back.B @ measure, act @ back.C, act @ back.D @ measure), sign=1)  # type: ignore[arg-type]
    assert isinstance(theirs, control.StateSpace)
    ours, weighted = closed_loop(car, controller), weighted_loop(car, controller)
    weights = [weight for weight in car.performance.values() if weight]
    z = [ours.output_labels.index(label.removeprefix("z[").removesuffix("]")) for label in weighted.output_labels]
    for omega in (0.1, 1.0, 8.0, 64.0, 1000.0):
        found, expected = ours(1j * omega), theirs(1j * omega)[:, : len(ours.input_labels)]
        size = np.abs(expected).max(axis=1, keepdims=True)
        assert np.abs((found - expected) / size).max() < 1e-8  # rounding of two ways to solve the loop, of a matrix of size 4e3
        np.testing.assert_allclose(weighted(1j * omega), np.array(weights)[:, None] * found[z], rtol=1e-9, atol=1e-12)
    assert controller.certificate.stable == bool(np.all(np.real(theirs.poles()) < 0))
    assert controller.certificate.norm.value >= max(np.linalg.norm(weighted(1j * w), 2) for w in np.geomspace(0.1, 1e3, 200))


@pytest.mark.parametrize("dt", [0, 0.004])
def test_there_and_back(paper, dt):
    """A law that goes out as a system and comes in again is the same to the last bit, sampled or not, with its names."""
    vehicle = replace(paper, implementation=Implementation(sample_period=dt or None))
    A, B, C, D = np.diag([0.3, 0.9]), np.array([[1.0, 2], [0, 1]]), np.array([[10.0, 20]]), np.array([[8000.0, -1000]])
    names = ["suspension_deflection", "sprung_velocity"]
    first = controller_from(vehicle, "mine", names, ss(A if dt else A - np.eye(2), B, C, D, dt))
    system = law_system(vehicle, first)
    again = controller_from(vehicle, "again", names, system)
    assert (system.input_labels, system.output_labels, system.dt) == (names, ["control_force"], dt)
    assert again.law.record == first.law.record
    assert again.certificate.norm.value == first.certificate.norm.value
    assert again.law.sample_period == (dt or None)


def test_names_count_not_places(paper):
    """A system that names its inputs is read by these names; one that does not, by their order; one with others is refused."""
    plain = ss([[-1.0]], [[1.0, 2.0]], [[3.0]], [[4.0, 5.0]])
    named = ss([[-1.0]], [[2.0, 1.0]], [[3.0]], [[5.0, 4.0]], inputs=["sprung_velocity", "suspension_deflection"])
    names = ["suspension_deflection", "sprung_velocity"]
    found = [controller_from(paper, "mine", names, system).law for system in (plain, named)]
    assert found[0].record == found[1].record
    bare = SimpleNamespace(A=plain.A, B=plain.B, C=plain.C, D=plain.D)
    assert controller_from(paper, "mine", names, bare).law.record == found[0].record
    other = ss([[-1.0]], [[1.0, 2.0]], [[3.0]], [[4.0, 5.0]], inputs=["e", "sprung_velocity"])
    with pytest.raises(InputError, match=r"has the input labels e, sprung_velocity; give sprung_velocity, suspension_defl"):
        controller_from(paper, "mine", names, other)


def test_order_of_forces():
    """A half-car's forces are found by their names, too."""
    vehicle, names = read_vehicle("half_car"), ["heave_velocity"]
    forces = list(vehicle.linear_model.inputs)
    assert names[0] in vehicle.linear_model.measurable
    system = ss([[-1.0]], [[1.0]], [[1.0], [2.0]], [[3.0], [4.0]], inputs=names, outputs=forces[::-1])
    law = controller_from(vehicle, "mine", names, system).law
    np.testing.assert_array_equal(law.C, [[2.0], [1.0]])
    np.testing.assert_array_equal(law.D, [[4.0], [3.0]])


@pytest.mark.parametrize(
    ("measured", "system", "said"),
    [
        (["sprung_velocity"], SimpleNamespace(A=[[1]]), "has no A, B, C and D"),
        (["sprung_velocity"], ss([[0.5]], [[1]], [[1]], [[0]], True), "has no sample period"),
        (["sprung_velocity"], ss([[0.5]], [[1]], [[1]], [[0]], 0.01), r"\[implementation\] sample_period = 0.01"),
        (
            ["sprung_velocity"],
            ss([[-1]], [[1, 1]], [[1]], [[0, 0]]),
            r"B has 1 row\(s\) of 2 number\(s\); give 1 row\(s\) of 1 number",
        ),
        (["road_velocity"], ss([[-1]], [[1]], [[1]], [[0]]), "road_velocity"),
        (["speed"], ss([[-1]], [[1]], [[1]], [[0]]), "unknown signal 'speed'"),
        (["sprung_velocity"], SimpleNamespace(A=[[np.nan]], B=[[1]], C=[[1]], D=[[0]]), "A has an entry that is not finite"),
        (["sprung_velocity"], SimpleNamespace(A=[[1, 2]], B=[[1]], C=[[1]], D=[[0]]), r"A has shape \(1, 2\)"),
        (["sprung_acceleration"], SimpleNamespace(A=[[-1]], B=[[0]], C=[[0]], D=[[504.5]]), "I - D_c D is singular"),
    ],
)
def test_what_is_no_controller_is_refused(paper, measured, system, said):
    """A system that is no controller of the vehicle is refused in one line that says why."""
    with pytest.raises(InputError, match=said):
        controller_from(paper, "mine", measured, system)


def test_no_system_of_nothing(paper, designer):
    """A controller that measures nothing is no system."""
    with pytest.raises(ValueError, match="measures nothing"):
        law_system(paper, designer.design("passive"))
