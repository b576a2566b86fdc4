"""Preview in the exact response of the paper's continuous closed loop.

The preview forces are Cp g with g' = -Ap g - d(t) + exp(Ap T) d(t + T) and d = Bp z_r' + Hp z_r; the state g decays backwards in
time. The matrix P solves the Sylvester equation A_G P + P Ap + B Cp = 0. With y = x - P g, the right-hand side depends on the
road but not on g, which is computed separately:

    y' = A_G y + Bw z_r' + Br z_r + P d(t) - P exp(Ap T) d(t + T).

The symbols are those of `sim.linear.sampled_response`.
"""

import numpy as np
from scipy import linalg

from models.common.arrays import Array, recursion
from models.laws.preview import RoadPreview
from models.roads.road import SAME_TIME, RoadInput, delays, jumps_under_wheels, under_wheels
from sim.linear.sampled_response import NODES, cut_steps, integrals_over_pieces, jump_forcing
from synth.plant.state_space import StateSpace

WHOLE = 1e-9  # a preview time counts as an integer number of steps if their relative difference is below this


def with_preview(
    preview: RoadPreview, system: StateSpace, road: RoadInput, forcing: Array, start: Array | None
) -> tuple[Array, Array]:
    """Returns the states of a continuous loop with preview, shape (T, n), and the preview forces [N], shape (T, m).

    Args:
        preview: preview of the loop's control law.
        system: closed loop in continuous time without preview, whose inputs are the control forces.
        road: road input.
        forcing: contribution of the road and its loads to the states over each step, shape (T, n).
        start: state of the loop at time 0, shape (n,); None for equilibrium.
    """
    ahead, P, drive = _preview_states(preview, system, road)
    moved = -P @ ahead[0] + (0.0 if start is None else start)
    Phi = linalg.expm(system.A * road.timestep)
    return _recursion_from(moved, Phi, (forcing + drive)[:-1]) + ahead @ P.T, ahead @ preview.C.T


def _preview_states(preview: RoadPreview, system: StateSpace, road_input: RoadInput) -> tuple[Array, Array, Array]:
    """Returns g, shape (T, k), P, shape (n, k), and the road's contribution to y over each step, shape (T, n); see the module
    docstring.

    Evaluating a random road takes most of the computing time. Each road value at a quadrature node is therefore used for all
    three integrals.

    Args:
        system: closed loop in continuous time, whose inputs are the control forces.
    """
    A, B = system.A, system.B
    road, vehicle, time, h, T = (
        road_input.relative_road,
        road_input.vehicle,
        road_input.time,
        road_input.timestep,
        preview.seconds,
    )
    kinks = np.array([kink + delay for kink in road.kinks for delay in delays(road, vehicle)])
    whole, later, count = int(T / h * (1 + WHOLE)), linalg.expm(preview.A * T), len(time)
    in_steps = abs(whole * h / T - 1) <= WHOLE
    P = linalg.solve_sylvester(A, preview.A, -B @ preview.C)

    def met(t: Array) -> Array:
        """Returns the preview input d (see module docstring) for an array of times, shape (T, k)."""
        pushed = under_wheels(road.velocity, road, vehicle, t) @ preview.B.T
        return pushed + under_wheels(road.displacement, road, vehicle, t) @ preview.H.T if preview.H.any() else pushed

    def change(t: Array) -> Array:
        """Returns the terms of the preview input d for the road that enters and leaves the preview window, shape (T, k)."""
        return met(t) - met(t + T) @ later.T

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    after = time[-1] + h * np.arange(whole)  # sample times between the end of the run and the end of the preview
    drive, ahead, end = np.zeros((count, len(A))), np.zeros((count, len(preview.A))), np.zeros((len(after), len(preview.A)))
    for s, weight in zip(h * (nodes + 1) / 2, h * weights / 2, strict=True):
        known = met(time[0] + h * np.arange(count + whole) + s)
        come = known[:count] - (known[whole:] if in_steps else met(time + T + s)) @ later.T
        drive += weight * come @ P.T @ linalg.expm(A * (h - s)).T
        ahead += weight * come @ linalg.expm(preview.A * s).T
        end += weight * known[count - 1 : count - 1 + whole] @ linalg.expm(preview.A * s).T
    cuts, beyond = cut_steps(np.concatenate([kinks, kinks - T]), time, h), cut_steps(kinks, after, h)
    steps = [k for k, _ in cuts]
    drive[steps] = integrals_over_pieces(A, lambda t: change(t) @ P.T, cuts, h)
    ahead[steps] = integrals_over_pieces(preview.A, change, cuts, h, backward=True)
    end[[k for k, _ in beyond]] = integrals_over_pieces(preview.A, met, beyond, h, backward=True)
    Phi = linalg.expm(preview.A * h)
    last = _recursion_from(np.zeros(len(preview.A)), Phi, end[::-1])[-1]
    if not in_steps:  # the preview ends inside a step, not at its end
        left, right = time[-1] + whole * h, time[-1] + T
        edges = [left, *np.unique(kinks[(kinks > left) & (kinks < right)]), right]
        (rest,) = integrals_over_pieces(preview.A, met, [(0, edges)], h, backward=True)
        last = last + linalg.expm(preview.A * (whole * h)) @ rest
    ahead = _recursion_from(last, Phi, ahead[-2::-1])[::-1]
    if road.jumps:
        drive += jump_forcing(A, P @ preview.B, road_input) - jump_forcing(A, P @ later @ preview.B, road_input, T)
        ahead = ahead + _leaps_ahead(preview, road_input)
    return ahead, P, drive


def _leaps_ahead(preview: RoadPreview, road_input: RoadInput) -> Array:
    """Returns the contribution that jumps of the road height within the preview make to the state g at the samples, shape (T,
    k).
    """
    time, h = road_input.time, road_input.timestep
    seen = np.zeros((len(time), len(preview.A)))
    for at, wheel, height in jumps_under_wheels(road_input.road, road_input.vehicle):
        left = at - time
        for k in np.flatnonzero((left >= -SAME_TIME * h) & (left < preview.seconds - SAME_TIME * h)):
            seen[k] += height * linalg.expm(preview.A * max(left[k], 0.0)) @ preview.B[:, wheel]
    return seen


def _recursion_from(start: Array, Phi: Array, forcing: Array) -> Array:
    """Returns the solution of x[k+1] = Phi x[k] + forcing[k], shape (T + 1, n), for the initial state `start`, shape (n,); see
    `recursion`.
    """
    return recursion(Phi, np.concatenate([start[None], forcing, start[None]]))[1:]
