"""Exact linear responses of the sampled loop that MuJoCo simulates, and of the paper's continuous closed loop.

Sampled loop. The forces are constant during each step. The road height is also constant, at its mid-step value or, for a
measured road, at its mean over the step (`RoadInput.midway`), as in `sim.drive`. The state xi = x - Bw z_r does not jump when
the road height z_r jumps. With the state xi, equation (29) becomes xi' = A xi + B u + (A Bw + Br) z_r. Over a step of length h,
the force u and the road height z_r are constant, so that

    xi[k+1] = Phi xi[k] + Gamma [u[k]; held z_r],    x[k] = xi[k] + Bw z_r(t_k),    u[k] = K C_y x[k].

If tyres have damping, Bw is J + Bt (`models/kinds/linear_model.py`). The matrix J then replaces Bw in the equations above. The
matrix Bt multiplies the road's mean velocity over the step, which is constant during the step like a load.

If a damper or a spring has a characteristic, the response is computed by RK4 (`sim.linear.stepped`), regardless of `exponential`.

Loads f on the body (`models/roads/loads/`) are also constant during each step, at mid-step values; loads from files have their
mean values over the step. The loads appear in the equations like the force u, with the matrix Bl instead of B. Signals and
measurements at a sample are computed with the load at this sample. The states of a control law and measured accelerations
enlarge the state vector (`synth/plant/loop.py`), but the equations remain the same.

Continuous loop. x' = A_G x + Bw z_r'(t) + Br z_r(t) with A_G = A + B K C_y. Over a step,

    x[k+1] = exp(A_G h) x[k] + integral of exp(A_G (h - s)) (Bw z_r' + Br z_r)(t_k + s) ds,

The integral is computed by Gauss-Legendre quadrature with 8 nodes, which is exact up to rounding errors for a smooth road. A
step during which the road has a kink is divided at the kink.

Preview. The preview forces, which depend on the road ahead, are added to the forces of the gain. In the sampled loop, the
preview forces are known in advance, because they are weighted sums of the road heights. `sim.linear.preview_response` computes
the preview forces of the continuous loop.
"""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg

from models.common.arrays import Array, recursion
from models.common.extensions import FEATURES
from models.kinds.signals import kept_signals
from models.roads.road import SAME_TIME, RoadInput, delays, jumps_under_wheels, under_wheels
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.linear.outputs import forces_ahead, response_by_name, with_linear_sides
from synth.controller.controller import Controller
from synth.controller.loop_of import HEIGHT, HELD, MIDWAY, READ, SIGNAL, loop_of, pushes, with_ending
from synth.plant.loop import Loop, respond
from synth.plant.state_space import StateSpace

NODES = 8  # number of nodes with which the integral over a step is computed (quadrature)

SLOWEST_RATE = 1e-12  # rad/s; a system with a lower fastest rate does not move within a run, and its time step would overflow


def taylor4(M: Array) -> Array:
    """Returns the matrix exponential as RK4 approximates it: the Taylor polynomial of degree 4.

    For a linear system, an RK4 step is a multiplication by exactly this polynomial.
    """
    identity = np.eye(len(M))
    return identity + M @ (identity + M / 2 @ (identity + M / 3 @ (identity + M / 4)))


def sampled_response(controller: Controller, road: RoadInput, exponential: Callable[[Array], Array] = linalg.expm) -> Response:
    """Returns the response of the sampled loop at the sample times of the road input, starting in equilibrium.

    Args:
        controller: linear controller of the vehicle that drives over the road.
        road: road input, which also contains the vehicle that drives over the road.
        exponential: function that computes the matrix exponential; with `taylor4`, the result is that of RK4 up to rounding
            errors.
    """
    return with_linear_sides(sampled_responses(controller, [road], exponential).run(0), road, True)


def sampled_responses(
    controller: Controller, roads: Sequence[RoadInput], exponential: Callable[[Array], Array] = linalg.expm
) -> Response:
    """Returns the responses to N roads; their values have shape (N, T, S). The arguments are those of `sampled_response`.

    The response contains the signals of the vehicle, then the states of the control law, each at the law's last sample.
    """
    vehicle, h = roads[0].vehicle, roads[0].timestep
    if vehicle.parts.nonlinear:
        return FEATURES.load("stepped response").stepped_runs([controller] * len(roads), roads).response
    loop = loop_of(vehicle, controller, h, exponential)
    inputs = disturbances(roads)
    if controller.preview is not None:
        ahead = np.stack([forces_ahead(controller.preview, road, len(loop.by_step)) for road in roads])
        inputs |= dict(zip(loop.forces, np.moveaxis(ahead, -1, 0), strict=True))
    return shown_signals(loop, roads, respond(loop, shown_outputs(loop), inputs, vehicle.start_state), controller)


def disturbances(roads: Sequence[RoadInput]) -> dict[str, Array]:
    """Returns the inputs of a vehicle over N roads, shape (N, T) each, by the input names of the sampled-data loop from
    `loop_of`.
    """
    model = roads[0].vehicle.linear_model
    groups = [("midway", model.disturbances, MIDWAY), ("heights", model.disturbances, HEIGHT)]
    if any(road.has_held_inputs for road in roads):
        held = pushes(model)
        groups += [("held_inputs", held, HELD), ("in_signals", held, SIGNAL), ("in_readings", held, READ)]
    return {
        f"{name}{ending}": np.stack([getattr(road, values)[:, i] for road in roads])
        for values, names, ending in groups
        for i, name in enumerate(names)
    }


def continuous_response(controller: Controller, road: RoadInput) -> Response:
    """Returns the response of the continuous closed loop (16), starting in equilibrium.

    The arguments are those of `sampled_response`.
    """
    loop, preview, model = loop_of(road.vehicle, controller), controller.preview, road.vehicle.linear_model
    system = loop.closed_loop.part(shown_outputs(loop), loop.closed_loop.inputs)
    Phi = linalg.expm(system.A * road.timestep)
    forcing, forces = road_forcing(system, road), np.zeros((len(road.time), len(loop.forces)))
    start = None if (moved := road.vehicle.start_state) is None else np.pad(moved, (0, len(Phi) - len(moved)))
    if preview is None:
        states = recursion(Phi, forcing, start)
    else:
        with_preview = FEATURES.load("preview in continuous loops").with_preview
        states, forces = with_preview(preview, system.part((), loop.forces), road, forcing, start)
    outputs = states @ system.C.T + acting_on(system, road, forces)
    response = shown_signals(loop, [road], outputs[None], controller).run(0)
    velocities, heights = (
        system.part(model.outputs, names) for names in (model.disturbances, with_ending(model.disturbances, HEIGHT))
    )
    return with_linear_sides(response, road, False, velocities.C @ velocities.B + heights.D)


def shown_outputs(loop: Loop) -> tuple[str, ...]:
    """Returns the names of the outputs that `shown_signals` needs: outputs of the plant, and states of the control law."""
    return (*loop.plant.outputs, *loop.law_states)


def shown_signals(loop: Loop, roads: Sequence[RoadInput], outputs: Array, controller: Controller) -> Response:
    """Converts the outputs `shown_outputs` over N roads, shape (N, T, p), to a response with all signals of the vehicle and the
    control law.
    """
    runs = [response_by_name(road, loop.plant.outputs, values) for road, values in zip(roads, outputs, strict=True)]
    kept = controller.law.of_state(loop.period or None) * outputs[..., len(loop.plant.outputs) :]
    vehicle = Response(roads[0].time, roads[0].vehicle.kind.signals, np.stack([run.values for run in runs]))
    return vehicle.with_signals(kept_signals(range(1, kept.shape[-1] + 1)), kept)


def acting_on(system: StateSpace, road: RoadInput, forces: Array) -> Array:
    """Returns the contribution of forces, road and loads to the outputs of a continuous system at the samples, shape (T, p)."""
    model = road.vehicle.linear_model
    names = (*model.inputs, *model.disturbances, *with_ending(model.disturbances, HEIGHT), *model.loads)
    return np.hstack([forces, road.velocities, road.heights, road.loads]) @ system.D[:, system.columns(names)].T


def road_forcing(system: StateSpace, road_input: RoadInput) -> Array:
    """Returns the contribution of a road and its loads to the states of a continuous system over each step, shape (T, n)."""
    road, vehicle, model, A = road_input.relative_road, road_input.vehicle, road_input.vehicle.linear_model, system.A
    Bw, Br, Bl = (system.part((), some).B for some in (model.disturbances, with_ending(model.disturbances, HEIGHT), model.loads))

    def push(t: Array) -> Array:
        pushed = under_wheels(road.velocity, road, vehicle, t) @ Bw.T
        return pushed + under_wheels(road.displacement, road, vehicle, t) @ Br.T if Br.any() else pushed

    forcing = _forcing_integral(
        A, push, np.array([kink + delay for kink in road.kinks for delay in delays(road, vehicle)]), road_input.time
    )
    if road_input.loaded:
        loads, kinks = road_input.road.loads, np.array(road_input.road.load_kinks)
        forcing += _forcing_integral(A, lambda t: loads(vehicle, t) @ Bl.T, kinks, road_input.time)
    return forcing + jump_forcing(A, Bw, road_input) if road.jumps else forcing


def jump_forcing(A: Array, Bw: Array, road_input: RoadInput, ahead: float = 0.0) -> Array:
    """Returns the contribution of jumps of the road height to the state, for each step, shape (T, n).

    A jump of the road height is an impulse of the road velocity, which acts through the matrix Bw.

    A jump at a sample time belongs to the step that begins at this time. Each jump acts `ahead` seconds before the wheel
    reaches it.
    """
    time, h = road_input.time, road_input.timestep
    leaps = np.zeros((len(time), len(A)))
    for met, wheel, height in jumps_under_wheels(road_input.road, road_input.vehicle):
        at = met - ahead
        k = math.floor((at - time[0]) / h * (1 + SAME_TIME))
        if 0 <= k < len(time):
            leaps[k] += height * linalg.expm(A * max(time[k] + h - at, 0.0)) @ Bw[:, wheel]
    return leaps


def _forcing_integral(A: Array, push: Callable[[Array], Array], kinks: Array, time: Array) -> Array:
    """Returns the contribution of push(t) to the state of x' = A x + push(t) over each step, shape (T, n).

    Args:
        A: system matrix of the differential equation, shape (n, n).
        push: function that returns the values of push(t) for an array of times, shape (.., n).
        kinks: times of kinks, at which the steps are divided [s].
        time: start of each step [s].
    """
    h = float(time[1] - time[0])
    forcing, cuts = _convolution(A, push, time, h), cut_steps(kinks, time, h)
    forcing[[k for k, _ in cuts]] = integrals_over_pieces(A, push, cuts, h)
    return forcing


def integrals_over_pieces(
    A: Array, push: Callable[[Array], Array], cuts: Sequence[tuple[int, list[float]]], h: float, backward: bool = False
) -> Array:
    """Returns the integral of exp(A (end - t)) push(t) over each of the K divided steps, shape (K, n).

    If `backward` is True, the integrand is exp(A (t - start)) push(t).

    The exponential within a step is approximated by a Chebyshev polynomial of degree 15, which is exact up to rounding for
    every step at which RK4 is stable.
    """
    if not cuts:
        return np.zeros((0, len(A)))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    pieces = np.array(
        [(i, left, right, edges[0], edges[-1]) for i, (_, edges) in enumerate(cuts) for left, right in itertools.pairwise(edges)]
    )
    step, left, right, start, end = pieces.T
    half = (right - left)[:, None] / 2
    t = left[:, None] + half * (nodes + 1)
    pushed = (half * weights).ravel()[:, None] * push(t.ravel())
    way = (t - start[:, None] if backward else end[:, None] - t).ravel()
    at = np.cos(np.pi * (np.arange(CHEBYSHEV) + 0.5) / CHEBYSHEV)  # Chebyshev nodes between -1 and 1, the range of 2 way / h - 1
    known = linalg.expm(A * (h * (1 + at) / 2)[:, None, None]).reshape(CHEBYSHEV, -1)
    shares = np.linalg.solve(np.polynomial.chebyshev.chebvander(at, CHEBYSHEV - 1), known).reshape(CHEBYSHEV, *A.shape)
    basis = np.polynomial.chebyshev.chebvander(2 * way / h - 1, CHEBYSHEV - 1)
    total = np.zeros((len(cuts), A.shape[0]))
    carried = sum(basis[:, [i]] * (pushed @ share.T) for i, share in enumerate(shares))
    np.add.at(total, np.repeat(step.astype(int), NODES), carried)
    return total


CHEBYSHEV = 16  # number of nodes of the Chebyshev polynomial, whose degree is one less


def cut_steps(kinks: Array, time: Array, h: float) -> list[tuple[int, list[float]]]:
    """Returns the steps that contain a kink: for each step, the index, and a list of the times of start, kinks and end [s]."""
    found = []
    for k in np.unique(np.floor((kinks - time[0]) / h).astype(int)) if len(time) else ():
        if 0 <= k < len(time):
            start, end = time[k], time[k] + h
            found.append((int(k), [start, *np.unique(kinks[(kinks > start) & (kinks < end)]), end]))
    return found


def _convolution(A: Array, push: Callable[[Array], Array], start: Array, h: float) -> Array:
    """Returns the integral of exp(A (h - s)) push(start + s) over s from 0 to h, shape (T, n), for T start times."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    total = np.zeros((len(start), len(A)))
    for s, weight in zip(h * (nodes + 1) / 2, h * weights / 2, strict=True):
        if (pushed := push(start + s)).any():
            total += weight * pushed @ linalg.expm(A * (h - s)).T
    return total


def largest_timestep(vehicle: Vehicle) -> float:
    """Returns the largest time step at which RK4 is stable for the vehicle without control [s], accurate to 1 %; infinite if
    nothing moves.

    This limit takes into account the softest and hardest setting of each semi-active damper, and the lag of the damper's valve.
    For the states of parts, the fastest rate is taken into account.
    """
    A, forces = vehicle.linear_model.A, vehicle.linear_model.inputs
    systems = [A, *(np.array([[-one.part.fastest]]) for one in vehicle.parts if one.part.fastest)]
    if vehicle.dampers:
        V = FEATURES.load("dampers in linear analysis").stretching_rates(vehicle)
        slopes = {one.force: one.slopes for one in vehicle.parts.adjustable}
        ends = np.array([slopes.get(force, (0.0, 0.0)) for force in forces]).T
        systems += [A - (vehicle.linear_model.B * d) @ V for d in ends]
        systems += [np.array([[-damper.bandwidth]]) for damper in vehicle.dampers.values() if damper.bandwidth is not None]
    return min(_largest_timestep(system) for system in systems)


def _largest_timestep(A: Array) -> float:
    """Returns the largest time step at which RK4 is stable for x' = A x [s]."""
    rate = float(np.abs(np.linalg.eigvals(A)).max())
    if rate <= SLOWEST_RATE:
        return math.inf
    steps = np.arange(3.0, 0.0, -0.01) / rate  # RK4 is unstable if |lambda h| is above 2.83
    for h in steps:
        if np.abs(np.linalg.eigvals(taylor4(A * h))).max() <= 1:
            return float(h)
    return math.nan
