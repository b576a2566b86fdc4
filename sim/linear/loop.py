"""The linear response, exact in two ways: of the sampled loop that MuJoCo runs, and of the paper's continuous closed loop.

Sampled. The controller is held over a step, and so is the road: at its midpoint height, where `physics.py` puts it. With
xi = x - Bw z_r, the state that does not jump when the road does, (29) becomes xi' = A xi + B u + (A Bw + Br) z_r, and over a step
everything on the right but xi is constant:

    xi[k+1] = Phi xi[k] + Gamma [u[k]; z_r(t_k + h/2)],    x[k] = xi[k] + Bw z_r(t_k),    u[k] = K C_y x[k].

Where a damper or a spring has a curve, every step is as in `sim.linear.curved`, and the rest stays.

Loads f on the body (`models/loads`) are held over a step as the road is, at what they are midway through it, and enter as u
does, with Bl in the place of B. A law with states, and a measured acceleration, make the vehicle larger
(`synth/implemented/controlled.py`), and the formulas stay as they are.

Continuous. x' = A_G x + Bw z_r'(t) + Br z_r(t) with A_G = A + B K C_y. Over a step,

    x[k+1] = exp(A_G h) x[k] + integral of exp(A_G (h - s)) (Bw z_r' + Br z_r)(t_k + s) ds,

by Gauss-Legendre quadrature with 8 nodes: exact to rounding for a smooth road. A step that holds a kink of the road is cut there.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.damping.range import range_of
from models.linear_model import LinearModel
from models.reality import steps_held, steps_per_sample
from models.roads.road import Road, delays, under_wheels
from models.signals import kept_signals
from models.vehicle import Vehicle
from sim.linear.curved import is_curved
from sim.linear.curved_steps import CurvedSteps
from sim.linear.dampers import linear_signals, stretching
from sim.response.response import Response
from synth.controller import Controller
from synth.implemented.controlled import Controlled, continuous, sampled
from synth.sampled.hold import held_inputs

SLOWEST_RATE = 1e-12  # rad/s; a mode that is slower does not move within any run, and a step for it would be beyond numbers


def taylor4(M: Array) -> Array:
    """What RK4 makes of the matrix exponential: its Taylor polynomial of degree 4. For a linear system RK4 is exactly that."""
    identity = np.eye(len(M))
    return identity + M @ (identity + M / 2 @ (identity + M / 3 @ (identity + M / 4)))


def sampled_response(
    vehicle: Vehicle,
    controller: Controller,
    road: Road,
    time: Array,
    exponential: Callable[[Array], Array] = linalg.expm,
) -> Response:
    """The response of the sampled loop, from rest.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: the road.
        time: equidistant sample times [s], shape (T,).
        exponential: the matrix exponential; `taylor4` to predict an RK4 integrator to rounding.
    """
    return sampled_responses(vehicle, controller, [road], time, exponential).run(0)


def sampled_responses(
    vehicle: Vehicle,
    controller: Controller,
    roads: Sequence[Road],
    time: Array,
    exponential: Callable[[Array], Array] = linalg.expm,
) -> Response:
    """The responses to N roads side by side, values of shape (N, T, S). Arguments as for `sampled_response`.

    Signals are the vehicle's and, after them, the states of the law, each as it was at the law's last sample.
    """
    h = float(time[1] - time[0])
    how = vehicle.implementation
    period = steps_per_sample(how, h)
    cut = sampled(vehicle, controller, period * h)
    model = cut.model
    loads = np.stack([held_loads(road, vehicle, time) for road in roads]) if any(road.loaded for road in roads) else None
    outside = [] if loads is None else [model.Bl]
    Phi, Gamma, Gamma_r, *Gamma_l = held_inputs(model.A, h, exponential, model.B, model.A @ model.Bw + model.Br, *outside)
    now = np.stack([under_wheels(road.displacement, road, vehicle, time) for road in roads])
    midway = np.stack([under_wheels(road.displacement, road, vehicle, time + h / 2) for road in roads])

    measured = [model.outputs.index(name) for name in controller.measured]
    jump, push = now @ model.Bw.T, midway @ Gamma_r.T  # x - xi, and what the road does to xi
    steps = CurvedSteps(vehicle, model, h, exact=exponential is not taylor4) if is_curved(vehicle) else None
    felt = None  # of loads, by way of accelerations: what they add to the forces asked for and to the rates of what is kept
    if loads is not None:
        push += loads @ Gamma_l[0].T
        # A reading is taken before a new load acts, as before a new force does.
        felt = np.concatenate([np.zeros_like(loads[:, :1]), loads[:, :-1]], axis=1) @ readings_of_loads(cut, controller).T
    if how.prompt and steps is None:
        G = cut.inputs(cut.asked)
        if felt is not None:
            felt = np.swapaxes(cut.inputs(*np.split(np.swapaxes(felt, 1, 2), [cut.forces], axis=1)), 1, 2)
            push += felt @ Gamma.T
        states = recursion(Phi + Gamma @ G, push + jump @ (Gamma @ G).T) + jump
        inputs = states @ G.T
        if felt is not None:
            inputs += felt
    else:
        states, inputs = np.zeros_like(jump), np.zeros((*jump.shape[:2], model.B.shape[1]))
        # By the sample at which they are computed, after as many as were on their way before the first.
        computed = np.zeros((len(time) // period + 1 + how.waiting, len(roads), cut.forces))
        xi, acting, held = np.zeros((len(roads), len(model.A))), [], steps_held(how, h)
        for k in range(len(time)):
            states[:, k] = xi + jump[:, k]
            if k % period == 0:
                newest = k // period + how.waiting
                computed[newest], kept = states[:, k] @ cut.asked.T, cut.kept @ states[:, k].T
                more = [] if felt is None else [felt[:, k]]
                if steps is not None:  # accelerations that are measured have the curves' forces in them
                    more.append(steps.beyond(states[:, k], now[:, k])[:, measured] @ cut.reading.T)
                for one in more:
                    computed[newest], kept = computed[newest] + one[:, : cut.forces], kept + one[:, cut.forces :].T
                forces = [computed[newest - late].T for _, late in held]
                of_parts = [cut.inputs(one, kept, forces[-1]).T for one in forces]
                acting = [one for (steps, _), one in zip(held, of_parts, strict=True) for _ in range(steps)]
            inputs[:, k] = acting[k % period]
            if steps is None:
                xi = xi @ Phi.T + inputs[:, k] @ Gamma.T + push[:, k]
            else:
                xi = steps(xi, inputs[:, k], midway[:, k], pushed=None if loads is None else loads[:, k] @ model.Bl.T)
    beyond = steps.beyond(states, now) if steps is not None else np.zeros(len(roads))
    if loads is not None:
        add = loads @ model.Dl.T
        beyond = add if steps is None else beyond + add
    runs = [response_of(vehicle, model, road, time, states[i], inputs[i], beyond[i]).values for i, road in enumerate(roads)]
    last = np.arange(len(time)) // period * period
    kept = controller.law.of_state(period * h) * states[:, last, cut.law_states]
    return _with_kept(Response(time, vehicle.kind.signals, np.stack(runs)), kept)


def continuous_response(vehicle: Vehicle, controller: Controller, road: Road, time: Array) -> Response:
    """The response of the continuous closed loop (16), from rest. Arguments as for `sampled_response`."""
    h = float(time[1] - time[0])
    cut = continuous(vehicle, controller)
    model, G = cut.model, cut.G
    A = model.A + model.B @ G

    forcing, felt, loads = road_forcing(A, model, road, vehicle, time), None, None
    if road.loaded:
        felt, loads = readings_of_loads(cut, controller), road.loads(vehicle, time)
        forcing += load_forcing(A, model.Bl + model.B @ felt, road, vehicle, time)
    states = recursion(linalg.expm(A * h), forcing)
    inputs = states @ G.T
    if loads is not None and felt is not None:
        inputs += loads @ felt.T
    response = response_of(vehicle, model, road, time, states, inputs, 0.0 if loads is None else loads @ model.Dl.T)
    return _with_kept(response, controller.law.of_state(None) * states[:, cut.law_states])


def _with_kept(response: Response, kept: Array) -> Response:
    """A response with the states of a law after the vehicle's signals, shape (..., T, k)."""
    return response.beside(kept_signals(range(1, kept.shape[-1] + 1)), kept)


def held_loads(road: Road, vehicle: Vehicle, time: Array) -> Array:
    """Loads on the body as they are held over the step from each of these times [s]: as they are midway, shape (T, l)."""
    return road.loads(vehicle, time + float(time[1] - time[0]) / 2)


def readings_of_loads(cut: Controlled, controller: Controller) -> Array:
    """What loads add to all inputs by way of measured accelerations, before what acts adds to rates, shape (m + k, l)."""
    rows = [cut.model.outputs.index(name) for name in controller.measured]
    return cut.reading @ cut.model.Dl[rows]


def road_forcing(A: Array, model: LinearModel, road: Road, vehicle: Vehicle, time: Array) -> Array:
    """What a road adds to the states of x' = A x + ... over the step from each of these times [s], shape (T, n)."""

    def push(t: Array) -> Array:
        pushed = under_wheels(road.velocity, road, vehicle, t) @ model.Bw.T
        return pushed + under_wheels(road.displacement, road, vehicle, t) @ model.Br.T

    return _forcing(A, push, np.array([kink + delay for kink in road.kinks for delay in delays(road, vehicle)]), time)


def load_forcing(A: Array, Bl: Array, road: Road, vehicle: Vehicle, time: Array) -> Array:
    """What the loads of a road add likewise, by way of Bl, shape (n, l)."""
    return _forcing(A, lambda t: road.loads(vehicle, t) @ Bl.T, np.array(road.load_kinks), time)


def _forcing(A: Array, push: Callable[[Array], Array], kinks: Array, time: Array) -> Array:
    """What x' = A x + push(t) gains over the step from each of these times [s], shape (T, n); cut at kinks [s]."""
    h = float(time[1] - time[0])
    forcing = _convolution(A, push, time, h)
    for k in np.unique(np.floor((kinks - time[0]) / h).astype(int)):
        if 0 <= k < len(time):
            start, end = time[k], time[k] + h
            edges = [start, *np.unique(kinks[(kinks > start) & (kinks < end)]), end]
            forcing[k] = 0.0
            for left, right in itertools.pairwise(edges):
                piece = _convolution(A, push, np.array([left]), right - left)[0]
                forcing[k] += linalg.expm(A * (end - right)) @ piece
    return forcing


def _convolution(A: Array, push: Callable[[Array], Array], start: Array, h: float) -> Array:
    """Integral of exp(A (h - s)) push(start + s) ds over 0..h, shape (T, n), for start times of shape (T,)."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    total = np.zeros((len(start), len(A)))
    for s, weight in zip(h * (nodes + 1) / 2, h * weights / 2, strict=True):
        total += weight * push(start + s) @ linalg.expm(A * (h - s)).T
    return total


def recursion(Phi: Array, forcing: Array) -> Array:
    """x[k+1] = Phi x[k] + forcing[k] from x[0] = 0, shape (..., T, n) like the forcing."""
    states = np.zeros_like(forcing)
    x, transposed = states[..., 0, :], np.ascontiguousarray(Phi.T)
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop may overflow; the run says so
        for k in range(forcing.shape[-2] - 1):
            x = states[..., k + 1, :] = x @ transposed + forcing[..., k, :]
    return states


def response_of(
    vehicle: Vehicle,
    model: LinearModel,
    road: Road,
    time: Array,
    states: Array,
    inputs: Array,
    beyond: Array | float = 0.0,
    beside: Mapping[str, Array] | None = None,
) -> Response:
    """Every signal of the vehicle from the states and inputs of a model of it over time, shapes (T, n) and (T, m).

    Args:
        vehicle: the vehicle.
        model: its own, or a larger one that has its states and inputs first.
        road: the road.
        time: shape (T,).
        states, inputs: over time.
        beyond: what curves and loads add to the outputs, shape (T, p), or 0.
        beside: signals that are no outputs of the model, of shape (T,); None for what its dampers would be for these inputs.
    """
    if beside is None:
        n, m = vehicle.linear_model.B.shape
        beside = linear_signals(vehicle, states[:, :n], inputs[:, :m])
    z_r, w = (under_wheels(function, road, vehicle, time) for function in (road.displacement, road.velocity))
    values = {}
    for i, wheel in enumerate(vehicle.kind.wheels):
        values |= {wheel.road_displacement: z_r[:, i], wheel.road_velocity: w[:, i]}
    outputs = states @ model.C.T + inputs @ model.D.T + z_r @ model.Cr.T + beyond
    values |= dict(zip(model.outputs, outputs.T, strict=True)) | dict(beside)
    signals = vehicle.kind.signals
    return Response(time, signals, np.stack([values[signal.name] for signal in signals], axis=-1))


def largest_timestep(vehicle: Vehicle) -> float:
    """The step [s] above which RK4 itself is unstable on the vehicle without control, to 1 %; infinite where nothing moves.

    Of adjustable dampers, with the softest and the hardest, and with the lag of their valves.
    """
    A, forces = vehicle.linear_model.A, vehicle.linear_model.inputs
    systems = [A]
    if vehicle.dampers:
        of, V = range_of([vehicle.adjustable], forces), stretching(vehicle)
        steepest = {one.force: one.steepest - one.nominal for one in vehicle.adjustable}
        firm = np.array([steepest.get(force, 0.0) for force in forces])
        systems += [A - (vehicle.linear_model.B * one) @ V for one in (np.where(of.adjustable, of.low[0], 0.0), firm)]
        systems += [np.array([[-one.bandwidth]]) for one in vehicle.dampers.values() if one.bandwidth is not None]
    return min(_largest_timestep(system) for system in systems)


def _largest_timestep(A: Array) -> float:
    """The same of x' = A x."""
    rate = float(np.abs(np.linalg.eigvals(A)).max())
    if rate <= SLOWEST_RATE:
        return math.inf
    steps = np.arange(3.0, 0.0, -0.01) / rate  # RK4 is unstable for every |lambda h| above 2.83
    for h in steps:
        if np.abs(np.linalg.eigvals(taylor4(A * h))).max() <= 1:
            return float(h)
    return math.nan
