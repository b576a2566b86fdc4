"""The MJCF is the vehicle of the equations, at rest, in motion and off the road."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import mujoco
import numpy as np
import pytest

from models.kinds.kind import GRAVITY
from models.vehicle.mjcf import build_model, mjcf_text
from tests.conftest import random_vehicles


@pytest.fixture(params=range(3))
def vehicle(request, paper):
    return [paper, *random_vehicles(paper, 2)][request.param]


def acceleration(model, qpos=0.0, qvel=0.0, ctrl=0.0, road=0.0):
    data = mujoco.MjData(model)
    data.qpos[:] += qpos
    data.qvel[:] = qvel
    data.ctrl[:] = ctrl
    data.mocap_pos[:, 2] = road
    mujoco.mj_forward(model, data)
    return data.qacc.copy()


def test_rest_is_equilibrium(vehicle):
    """At qpos = 0 gravity and the preloads balance."""
    assert np.abs(acceleration(build_model(vehicle, 1e-3))).max() < 1e-9  # m/s2; measured 1e-13


def test_linearisation_is_the_papers(vehicle):
    """A, B and Bw found by differences of qacc are (31)-(32)."""
    model, linear = build_model(vehicle, 1e-3), vehicle.linear_model
    body, wheel = (int(model.joint(name).dofadr[0]) for name in ("sprung", "unsprung"))
    h = 1e-3  # m, m/s, N: the model is linear as long as the wheel stays on the road
    columns = {
        "suspension_deflection": {"qpos": h * np.eye(model.nv)[body]},
        "tyre_deflection": {"road": -h},  # both masses stay: only the tyre changes length
        "sprung_velocity": {"qvel": h * np.eye(model.nv)[body]},
        "unsprung_velocity": {"qvel": h * np.eye(model.nv)[wheel]},
    }
    rest = acceleration(model)
    for state, change in columns.items():
        found = (acceleration(model, **change) - rest) / h
        expected = linear.A[2:, linear.states.index(state)]
        np.testing.assert_allclose(found[[body, wheel]], expected, atol=1e-9 * np.abs(linear.A).max())
    found = (acceleration(model, ctrl=h) - rest) / h
    np.testing.assert_allclose(found[[body, wheel]], linear.B[2:, 0], atol=1e-9)


def test_attached_mjcf_is_the_model_that_ran(vehicle):
    """The MJCF text that goes into the logs compiles to the same model, bit for bit."""
    again, model = mujoco.MjModel.from_xml_string(mjcf_text(vehicle, 5e-4)), build_model(vehicle, 5e-4)
    for field in ("body_mass", "tendon_stiffness", "tendon_damping", "tendon_lengthspring"):
        np.testing.assert_array_equal(getattr(again, field), getattr(model, field))
    assert again.opt.timestep == model.opt.timestep


def test_tyre_pushes_and_never_pulls(vehicle):
    """With the road far below, the wheel falls with gravity and the suspension alone acts on it."""
    model, p = build_model(vehicle, 1e-3), vehicle.parameters
    data_acceleration = acceleration(model, road=-1.0)
    wheel = int(model.joint("unsprung").dofadr[0])
    static_load = p["sprung_mass"] * GRAVITY  # what the suspension spring carries at rest
    assert data_acceleration[wheel] == pytest.approx(-GRAVITY - static_load / p["unsprung_mass"], rel=1e-12)


def test_sensors_are_named_as_the_signals(paper):
    """Every output of the linear model is a sensor of that name, with a direction to read it along."""
    model = build_model(paper, 1e-3)
    for name in paper.linear_model.outputs:
        assert np.linalg.norm(model.sensor(name).user) == 1.0
