"""Speed of an identification: the paper's car, a chirp at 200 Hz and three sensors, against two ways of doing it by hand.

    python -m pytest tests/benchmarks/bench_identify.py

Four parameters are estimated from values that are 5 to 40 % off. All ways end within 10 % of the truth:
MuJoCo's steps of 5 ms have an error of a few percent.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import time
from collections.abc import Callable

import mujoco
import mujoco.rollout
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from models.common.arrays import Array
from models.vehicle.mjcf import build_model
from sim.studies.identification.estimation.estimate import estimate
from sim.studies.identification.experiment import Experiment
from sim.studies.identification.prediction import midpoints
from tests.benchmarks.pairs import paired_ratio
from tests.sim.test_identify import BODY, CAR, HUB, NOISE, TRAVEL, P, chirp, log, problem

NAMES = [name for name in P if name != "sprung_mass"]
FIRST = np.array([1.3, 0.8, 1.4, 0.85])
NEAR = np.array([1.1, 0.9, 1.2, 0.95])  # from FIRST, SciPy's search ends in another minimum
SENSORS, STEP = (BODY, HUB, TRAVEL), 0.005
Residuals = Callable[[Array], Array]  # of factors of the first values


def measured(duration: float) -> Experiment:
    """Returns a log of the car with noise."""
    return log(CAR, SENSORS, chirp(duration, STEP), step=STEP)


def ours(experiment: Experiment, start: Array) -> Array:
    """Returns the estimated factors of the truth, with intervals and whiteness beside."""
    first = CAR.altered({name: P[name] * factor for name, factor in zip(NAMES, start.tolist(), strict=True)})
    of = estimate(problem(experiment, first), NAMES)
    return np.array([of.values[name] / P[name] for name in NAMES])


def over_noise(experiment: Experiment, predicted: Array) -> Array:
    """Returns the residuals of signals without their means, shape (3 T,)."""
    values = np.stack([one.values for one in experiment.channels], axis=-1)
    residuals = (predicted - predicted.mean(axis=0) - values + values.mean(axis=0)) / [NOISE[one] for one in SENSORS]
    return residuals.ravel()


def in_mujoco(experiment: Experiment) -> Residuals:
    """Returns the residuals of the car's own model in MuJoCo's rollout, in steps of the log; the road is a mocap body."""
    model = build_model(CAR, STEP)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.zeros(size)
    mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    road = np.tile(data.mocap_pos[0], (len(experiment.road), 1))
    road[:, 2] += midpoints(experiment.road)[:, 0]
    places = [model.sensor(name).adr[0] + 2 * (name != TRAVEL) for name in SENSORS]
    g, (suspension, tyre) = 9.81, (model.tendon(name).id for name in ("suspension", "tyre"))
    rest = model.tendon_lengthspring[:, 0] - [P["sprung_mass"] * g / P["suspension_stiffness"], 0.0]
    hub = model.tendon_lengthspring[tyre, 0] - (P["sprung_mass"] + P["unsprung_mass"]) * g / P["tyre_stiffness"]

    def residuals(factors: Array) -> Array:
        p = {**P, **{name: P[name] * factor for name, factor in zip(NAMES, factors, strict=True)}}
        model.body("unsprung").mass[0] = p["unsprung_mass"]
        model.tendon_stiffness[[suspension, tyre]] = p["suspension_stiffness"], p["tyre_stiffness"]
        model.tendon_damping[suspension] = p["suspension_damping"]
        model.tendon_lengthspring[suspension] = rest[suspension] + p["sprung_mass"] * g / p["suspension_stiffness"]
        model.tendon_lengthspring[tyre, 0] = hub + (p["sprung_mass"] + p["unsprung_mass"]) * g / p["tyre_stiffness"]
        mujoco.mj_setConst(model, data)
        spec = mujoco.mjtState.mjSTATE_MOCAP_POS
        _, sensors = mujoco.rollout.rollout(model, data, start[None], road[None], control_spec=int(spec))
        return over_noise(experiment, np.asarray(sensors)[0][:, places])  # as read before each step

    return residuals


def by_solve_ivp(experiment: Experiment) -> Residuals:
    """Returns the residuals of four equations of motion in SciPy's solver, with its usual tolerances tightened to 1e-6."""
    times = experiment.time

    def residuals(factors: Array) -> Array:
        m_u, k, c, k_t = (P[name] * factor for name, factor in zip(NAMES, factors, strict=True))
        m_s = P["sprung_mass"]

        def rate(t: float | Array, x: Array) -> list[Array]:
            force = k * (x[0] - x[1]) + c * (x[2] - x[3])
            return [x[2], x[3], -force / m_s, (force - k_t * (x[1] - np.interp(t, times, experiment.road[:, 0]))) / m_u]

        x = solve_ivp(rate, (0, times[-1]), np.zeros(4), t_eval=times, rtol=1e-6, atol=1e-9, max_step=STEP).y
        rates = rate(times, x)
        return over_noise(experiment, np.stack([rates[2], rates[3], x[0] - x[1]], axis=-1))

    return residuals


def compare(benchmark, call: Callable[[], Array], reference: Callable[[], Array], claim: float) -> None:
    """Fails if the ratio of processor times exceeds the claim, or an estimate is more than 10 % off."""
    ends = list[Array]()
    paired_ratio(benchmark, lambda: ends.append(call()), lambda: ends.append(reference()), 1, claim, time.process_time)
    np.testing.assert_allclose(np.stack(ends), 1.0, atol=0.1)


@pytest.mark.goal
def test_identify_and_mujoco_sysid(benchmark):
    """An estimate from 10 s takes no longer than `mujoco.sysid.optimize` over MuJoCo's own rollout of the same car."""
    sysid = pytest.importorskip("mujoco.sysid")
    if not hasattr(sysid, "optimize"):
        pytest.skip("needs mujoco[sysid]")
    experiment = measured(10)
    residuals = in_mujoco(experiment)

    def columns(x: Array, _: object) -> tuple[list[Array], list[Array], list[Array]]:
        each = [residuals(one) for one in x.reshape(len(FIRST), -1).T]  # the optimiser perturbs all parameters at once
        return [each[0] if x.ndim == 1 else np.stack(each, axis=-1)], [], []

    def reference() -> Array:
        parameters = sysid.ParameterDict()
        for name, first in zip(NAMES, FIRST, strict=True):
            parameters.add(sysid.Parameter(name, first, 0.1, 10.0))
        best, _ = sysid.optimize(parameters, columns, verbose=False)
        return best.as_vector()

    compare(benchmark, lambda: ours(experiment, FIRST), reference, 1.0)


@pytest.mark.goal
def test_identify_and_solve_ivp(benchmark):
    """An estimate from 2 s takes at most a tenth of a fit by finite differences through `solve_ivp`."""
    experiment = measured(2)
    residuals = by_solve_ivp(experiment)

    def reference() -> Array:
        return least_squares(residuals, NEAR, diff_step=1e-4).x  # smaller differences are lost in the solver's error

    compare(benchmark, lambda: ours(experiment, NEAR), reference, 0.1)
