"""Steps of MuJoCo with parts that have states and inertia, beside clipped and lagging actuators, against own equations."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

from typing import Any

import mujoco
import numpy as np
import pytest

from models.parts.native import MOTOR
from models.vehicle.mjcf import FITTED_PREFIX, build_spec
from models.vehicle.suspension_forces import SuspensionForces
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.drive.part_steps import PartBatch

H, STEPS = 1e-3, 250
LIMITS = "\n[limits]\nactuator_force = 150.0\nactuator_bandwidth = 60.0\n"


class Toy(SuspensionForces):
    """A hysteretic and a cubic force with one state on each suspension, a share of the actuators' forces, and an inerter."""

    def __init__(self, inertance: np.ndarray | None, count: int, suspensions: int) -> None:
        self.b: Any = inertance
        self.inertial, self.states = inertance is not None, suspensions
        self.size = 1.0 + np.arange(count * suspensions).reshape(count, suspensions) / 4

    def __call__(self, d, v, inputs, z: Any = None):
        share = 0.2 * inputs if inputs.shape == d.shape else 0.0
        return self.size * (2e4 * z + 4e6 * d**3) - share

    def inertance(self, d):
        return self.b

    def rates(self, d, v, inputs, z):
        return self.rate(v, z)

    def rate(self, v, z):
        return v - 40.0 * np.abs(v) * z - 20.0 * v * np.abs(z)


def with_motors(vehicle: Vehicle) -> mujoco.MjModel:
    """A model with motors for parts on all suspensions."""
    spec = build_spec(vehicle, H)
    for part in vehicle.kind.suspensions:
        motor = spec.add_actuator(name=f"{FITTED_PREFIX}{MOTOR}{part.tendon}", target=part.tendon)
        motor.trntype, motor.gainprm[0] = mujoco.mjtTrn.mjTRN_TENDON, -1.0
    return spec.compile()


def batch_with(vehicles: list[Vehicle], toy: Toy) -> PartBatch:
    models = [with_motors(one) for one in vehicles]
    return PartBatch(models[0], [part.tendon for part in vehicles[0].kind.suspensions], toy, len(models), models)


def rk4(rate, y: np.ndarray) -> np.ndarray:
    k1 = rate(y)
    k2 = rate(y + H / 2 * k1)
    k3 = rate(y + H / 2 * k2)
    return y + H / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + H * k3))


@pytest.mark.parametrize("inertance", [None, np.array([[80.0], [150.0]])], ids=["states", "inertia"])
def test_a_quarter_car(inertance):
    """Two unlike cars side by side follow their equations, with clipped and lagging commands, and each runs as alone."""
    text = read_vehicle("quarter_car").text.partition("[controllers")[0] + LIMITS
    vehicles = [parse_vehicle(text), parse_vehicle(text.replace("sprung_mass = 504.5", "sprung_mass = 350.0"))]
    toy, b = Toy(inertance, 2, 1), np.zeros(2) if inertance is None else inertance[:, 0]
    batch = batch_with(vehicles, toy)
    alone = Toy(None if inertance is None else inertance[1:], 1, 1)
    alone.size = toy.size[1:]
    second = batch_with(vehicles[1:], alone)
    sensors, vertical = batch.bind("sensordata"), int(batch.model.sensor("sprung_acceleration").adr[0]) + 2
    keys = ("sprung_mass", "unsprung_mass", "suspension_stiffness", "suspension_damping", "tyre_stiffness")
    m_s, m_u, k, c, k_t = np.array([[one.parameters[key] for key in keys] for one in vehicles]).T
    mass = np.moveaxis(np.array([[m_s + b, -b], [-b, m_u + b]]), 2, 0)
    joints = [batch.model.joint(name).id for name in ("sprung", "unsprung")]

    def rate(y):
        (_, z_u, v_s, v_u, act, z), d, v = y, y[0] - y[1], y[2] - y[3]
        u, size = np.clip(act, -150.0, 150.0), toy.size[:, 0]
        pull = k * d + c * v + size * (2e4 * z + 4e6 * d**3) - 1.2 * u
        on_hub = k_t * np.minimum(z_u - road, (m_s + m_u) * 9.81 / k_t)
        force = np.stack([-pull, pull - on_hub], axis=-1)
        acceleration = np.linalg.solve(mass, force[..., None])[..., 0].T
        return np.stack([v_s, v_u, *acceleration, 60.0 * (command - act), toy.rate(v, z)])

    y, clipped = np.zeros((6, 2)), 0
    for n in range(STEPS):
        road, command = 0.03 * (1 - np.cos(2 * np.pi * n * H / 0.2)), 900.0 * np.sin(40.0 * n * H)
        felt, y = rate(y)[2], rk4(rate, y)
        clipped += np.abs(y[4, 0]) > 150.0
        for one in (batch, second):
            one.bind("mocap_pos")[:, :, 2], one.bind("ctrl")[:, 0] = road, command
            one.step()
        own = [*batch.bind("qpos")[:, joints].T, *batch.bind("qvel")[:, joints].T, batch.bind("act")[:, 0], batch.z[:, 0]]
        np.testing.assert_allclose(own, y, rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(sensors[:, vertical] - 9.81, felt, rtol=1e-9, atol=1e-9)  # as at the beginning of the step
    assert 20 < clipped < STEPS - 20
    np.testing.assert_array_equal(batch.state[1:], second.state)
    np.testing.assert_array_equal(batch.z[1:], second.z)
