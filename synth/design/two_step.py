"""The paper's two-step method: two LMI problems give a static output-feedback gain and its certificate (section 2).

    x' = A x + B u + Bw w,    z = C x + D u + Dw w,    y = C_y x        (15), Dw = 0 in the paper

Step 1 designs a state feedback u = G_s x: it maximises eta = norm^-2 subject to an LMI in X and Y. For u = K y, X and Y must
also fulfil Y X^-1 = K C_y (8), which is not a convex condition. Step 2 therefore maximises eta only over pairs X, Y of the form
(12). Pairs of the form (12) are a convex set for every matrix L, and each pair gives a gain K. If L is given by (14), the X of
step 1 has the form (12). The optimum of each step is the limit of its central path (`synth.lmi.central_path`), which depends
neither on a solver nor on units.

The functions above `well_posed` implement the formulas of the paper. The functions below `well_posed` choose independent
measurements and units. If step 2 has no solution for the optimal X of step 1, the functions below `well_posed` use the X of an
earlier point on the central path. `synth.design.degenerate` treats plants whose problem (22) has no optimum.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.laws.linear import unchecked_static_law
from synth.analysis.certificate import FASTEST, Certificate, KnownBound, certify
from synth.design.problem import TWO_STEPS, DesignProblem, DesignResult, Progress, WellPosedProblem
from synth.lmi.central_path import LIMIT, CentralPoint, central_path, fits, unknowns
from synth.lmi.output_nulling import sees_every_state
from synth.plant.generalized import Feedback, Plant, check_inputs, check_states, on_all_rows
from synth.plant.numerics import DesignError, InfeasibleError, NoSolutionError, numerics
from synth.plant.units import independent, own_units, unit_rows

# Largest number of variables in the LMI of step 1 (45 states, one input). Step 2 can then be solved for several X in a minute
MOST = 1100
SAME = 1e-9  # a state gain G counts as equal to K C_y if their relative difference is smaller than this


def state_feedback(plant: Plant, mu: float = LIMIT) -> list[CentralPoint]:
    """Returns the central path of problem (22). The K of the last point is the state gain G_s with the smallest norm.

    Args:
        mu: value of the path parameter at which the path ends; see `central_path`.

    Raises:
        NoSolutionError: there is a mode that no state feedback changes by more than rounding errors.
    """
    n = len(plant.A)
    # State feedback is found by a problem of the form (2): max eta  subject to  F(X, Y, eta) < 0 (24),  X > 0.  (22) The force
    # is then u = G_s x (1) with the gain G_s = Y X^-1 (3), and the norm is eta^-1/2 (23).
    return central_path(plant, Q=np.zeros((n, 0)), R=np.eye(n), mu=mu)


def nullspace(Cy: Array) -> Array:
    """Returns Q, an orthonormal basis of the nullspace of C_y, shape (n, n - q). The gain K does not depend on the choice of
    this basis.
    """
    return linalg.null_space(unit_rows(Cy)[0])


def l_matrix(X: Array, Cy: Array, Q: Array) -> Array:
    """Returns L = Q^+ X C_y' (C_y X C_y')^-1, shape (n - q, q), equation (14).

    With L from (14), R = X C_y' (C_y X C_y')^-1, and X = Q X_Q Q' + R X_R R' (12) with X_R = C_y X C_y'.

    Args:
        X: matrix X that solves the state-feedback problem (22), shape (n, n).
        Cy: measurement matrix, shape (q, n), of full row rank.
        Q: basis of the nullspace of C_y, shape (n, n - q).

    Raises:
        DesignError: C_y X C_y' is singular up to rounding.
    """
    rows, lengths = unit_rows(Cy)
    try:
        return np.linalg.pinv(Q) @ X @ rows.T @ np.linalg.inv(rows @ X @ rows.T) / lengths  # equation (14)
    except np.linalg.LinAlgError as error:
        raise DesignError(
            f"L (14) could not be computed: C_y X C_y' is singular to rounding ({error}), as X grows without bound or vanishes "
            "in a measured signal; weight that signal, or the control force, more"
        ) from error


def r_matrix(Cy: Array, Q: Array, L: Array) -> Array:
    """Returns R = C_y^+ + Q L, shape (n, q), equation (9)."""
    rows, lengths = unit_rows(Cy)
    return np.linalg.pinv(rows) / lengths + Q @ L  # equation (9)


def output_feedback(plant: Plant, L: Array, Q: Array) -> list[CentralPoint]:
    """Returns the central path of problem (25) for a given L. The K of the last point is the gain Y_R X_R^-1 (13).

    Args:
        plant: plant whose C_y, shape (q, n), has full row rank.
        L: matrix L of (14), or zero for the one-step design of remark 4 of the paper, shape (n - q, q).
        Q: basis of the nullspace of C_y, shape (n, n - q).

    Raises:
        NoSolutionError: (25) has no solution with eta > 0 for the given L.
    """
    R = r_matrix(plant.Cy, Q, L)
    try:
        # Problem (7), over all X and Y with Y X^-1 = K C_y (8), is not convex. With X = Q X_Q Q' + R X_R R' and Y = Y_R R'
        # (12), equation (11) gives the restricted problem (10):  max eta  subject to  F(X_Q, X_R, Y_R, eta) < 0,  X_Q > 0,  X_R
        # > 0.  (25) Then Y X^-1 = K C_y with K = Y_R X_R^-1 (13), and the norm is at most eta^-1/2 (26).
        return central_path(plant, Q, R)
    except NoSolutionError as error:
        which, advice = ("L = 0", ", or use the L of equation (14)") if L.size and not np.any(L) else ("this L", "")
        raise NoSolutionError(f"problem (25) has no solution with eta > 0 for {which}: {error}{advice}") from error


def independent_rows(plant: Plant) -> list[int]:
    """Returns the indices of the rows of C_y that are linearly independent of all earlier rows, in ascending order.

    Equation (9) requires full row rank. The states are scaled by `own_units`, and each row is scaled to length one, so the result
    does not depend on units. No row may be zero.
    """
    return independent(plant.Cy * own_units(plant, measured=True).states)


@functools.lru_cache(maxsize=2)  # both steps of a design call this function with the same plant, and plants do not change
def well_posed(plant: Plant) -> WellPosedProblem:
    """Returns problem (22) of a plant or, if (22) is degenerate, a regularised problem. The result does not depend on units.

    Raises:
        InputError: the plant has no state.
    """
    check_states(len(plant.A))
    plant = plant.unmeasured
    if np.any(plant.Bw) and np.any(plant.C):
        scale, forces = own_units(plant).exact
        own = plant.differences.in_coordinates(np.diag(scale)).with_inputs(np.diag(forces))
        if sees_every_state(own):
            return WellPosedProblem(plant, regular=True)

    return FEATURES.load("degenerate plants").regularise_problem(plant)


NO_SECOND_STEP = "problem (25) has no solution for the X of (22), but another gain may exist"
NO_GAIN = "no static gain found"


def no_gain(tried: str, more: str = "") -> str:
    """Returns an error message for a search that found no stabilising static gain: advice, followed by a list of what was
    tried.
    """
    return f'{NO_GAIN}; measure more signals, {more}or give order = "full", a law with states (tried: {tried})'


@numerics()
def state_path(plant: Plant, states: Sequence[str] = ()) -> list[CentralPoint]:
    """Returns the central path of (22) in the units of the given plant.

    If (22) has no optimum, a regularised problem replaces it.

    Raises:
        InfeasibleError: the plant cannot be stabilised; the message describes the mode that cannot be stabilised.
        DesignError: there is no central path, or the path could not be followed; the message gives the reason. For example, no
            path exists if an integrator does not affect z, or if a control force has no weight.
    """
    problem, plant = well_posed(plant), plant.unmeasured
    own = own_units(plant)
    if not problem.regular:
        FEATURES.load("degenerate plants").check_marginal_modes(plant, problem.plant, states)
    try:
        return [point.in_units(own.states, own.inputs, own.states) for point in state_feedback(own.into(problem.plant))]
    except NoSolutionError as error:
        if reasons := "; ".join(FEATURES.load("obstacles to stabilisation").stabilisability_failures(plant, states)):
            raise InfeasibleError(reasons) from error
        raise
    except DesignError as error:
        raise type(error)("; ".join(FEATURES.load("degenerate plants").unpenalised_inputs(plant)) or str(error)) from error


@numerics()
def state_design(plant: Plant, path: Sequence[CentralPoint] = (), lower_bound: KnownBound = None) -> DesignResult:
    """Designs the state feedback with the smallest norm, which is the optimum of (22).

    Args:
        path: central path from `state_path`; if empty, the path is computed.
        lower_bound: lower bound on the norm of every state feedback; the certificate contains this bound.

    Raises:
        InfeasibleError, DesignError: `state_path` raises this type of error, or no certificate holds.
    """
    problem, measured = well_posed(plant), plant.measured(np.eye(len(plant.A)))
    if problem.best is not None:
        certificate = FEATURES.load("bounds by Riccati equations").certify_tightly(plant, problem.best, lower_bound)
        return _result(problem.best, certificate, case=problem.best_case)
    return replace(last_certified_gain(measured, path or state_path(plant), lower_bound), case=problem.case)


def last_certified_gain(plant: Plant, path: Sequence[CentralPoint], lower_bound: KnownBound = None) -> DesignResult:
    """Returns the last gain of a central path whose certificate holds and whose loop is slow enough for actuators.

    The loops of all certified gains may be too fast compared with the plant, for example if the plant hardly moves without
    control. If all certified loops are too fast, speeds are compared with the slowest of these loops, and not with the plant.

    Raises:
        DesignError: no certificate holds.
    """
    first: Certificate | None = None
    beyond: list[DesignResult] = []
    for i in reversed(range(len(path))):
        point = path[i]
        X = point.X if point.proof is None else point.proof
        # The notation is y = C_y x (4), u = K y (5) and G = K C_y (6). The norm in the certificate is the norm (27), computed
        # by two methods.
        certificate = certify(plant, Feedback(point.K, plant.Cy), X, point.eta, lower_bound)
        if not certificate.loop_failures:
            before = path[max(i - 1, 0)].K
            moved = float(np.abs(point.K - before).max(initial=0.0) / (np.abs(point.K).max(initial=0.0) or 1.0))
            design = _result(point.K, certificate, optimum_gap=point.gamma / path[-1].gamma - 1, moved=moved)
            if not certificate.beyond_actuators:
                return design
            beyond.append(design)
        first = first or certificate
    if beyond:
        slowest = min(design.certificate.speed_up for design in beyond)
        return next(design for design in beyond if design.certificate.speed_up <= FASTEST * slowest)
    if first is None:
        raise DesignError("its certificate fails: the path has no point")
    # The matrix X of the path may be too close to singular for a proof in floating point, for example with 40 states. Another X
    # may still prove a bound.
    another = FEATURES.load("bounds by Riccati equations").certify_tightly(plant, Feedback(path[-1].K, plant.Cy), lower_bound)
    if another.bound is not None and not another.failures:
        return _result(path[-1].K, another)
    raise DesignError(f"its certificate fails: {'; '.join(first.loop_failures)}")


@numerics()
def two_step_design(
    plant: Plant,
    Cy: Array | None = None,
    path: Sequence[CentralPoint] = (),
    lower_bound: KnownBound = None,
    states: Sequence[str] = (),
) -> DesignResult:
    """Designs a static gain by the paper's two-step method: the X of (22) gives L (14), with which (25) gives the gain.

    The result includes the certificate of the gain. The second problem (25) may be infeasible for the optimal X, but feasible
    for the X of an earlier point on the central path. The X of the last point at which (25) is feasible is then used. The plant
    is first scaled to internal units, so that the result does not depend on the units of the plant.

    Args:
        plant: generalised plant with n states and m inputs.
        Cy: matrix of the measurements y = C_y x, shape (q, n). Default: the Cy of the plant. If a row of C_y depends linearly
            on other rows, the gain on this row is zero.
        path: central path of (22); if empty, the path is computed.
        lower_bound: lower bound on the norm of every controller that uses the measurements; the certificate contains this
            bound.
        states: names of the states, used in error messages.

    Returns:
        The law u = K y with K of shape (m, q), and its certificate. `redundant` contains the indices of dependent rows of C_y.

    Raises:
        InputError: C_y does not fit the plant, or is empty.
        InfeasibleError: no static gain from y stabilises the plant; the message describes the mode that cannot be stabilised.
        TooLargeError: (22) has more than 1100 optimisation variables (45 states with one input).
        DesignError: (25) has no solution for any X that was tried, a central path ended early, or no certificate holds. A
            stabilising gain may exist even if a DesignError is raised.

    Example:
        >>> from synth import GeneralizedPlant, two_step_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = two_step_design(oscillator, Cy=[[0, 1]])
        >>> design.gain.shape, f"{design.certificate.norm.value:.4f}", design.certificate.failures
        ((1, 1), '0.2500', ())
    """
    plant, independent, kept = independently_measured(plant if Cy is None else plant.measured(Cy))
    problem, q = well_posed(plant), len(plant.Cy)
    units = own_units(plant, measured=True)
    rows, measured = units.rows(independent.Cy)
    if problem.best is not None:
        G = problem.best * units.states
        on_rows = G @ rows.T
        if np.linalg.norm(on_rows @ rows - G) <= SAME * np.linalg.norm(G):
            K = np.linalg.solve(measured.T, on_rows.T).T
            riccati = FEATURES.load("bounds by Riccati equations")
            certificate = riccati.certify_tightly(independent, Feedback(K, independent.Cy), lower_bound)
            return with_redundant_rows(_result(K, certificate, case=problem.best_case), kept, q, 0.0)
    fits(unknowns(problem.plant), MOST, "the two-step method")
    path = path or state_path(plant, states)
    own, Q = units.into(problem.plant).measured(rows), nullspace(rows)
    failures: list[DesignError] = []
    beyond: list[DesignResult] = []
    for start in reversed(path):
        try:
            L = l_matrix(start.X / np.outer(units.states, units.states), rows, Q)
            points = [point.in_units(units.states, units.inputs, measured) for point in output_feedback(own, L, Q)]
            found = last_certified_gain(independent, points, lower_bound)
        except DesignError as error:
            failures.append(error)
            continue
        found = with_redundant_rows(replace(found, case=problem.case), kept, q, start.gamma / path[-1].gamma - 1)
        if not found.certificate.beyond_actuators:
            return found
        beyond.append(found)
    if beyond:
        return min(beyond, key=lambda design: design.certificate.speed_up)
    obstacles = FEATURES.load("obstacles to stabilisation")
    if reasons := "; ".join(obstacles.stabilisability_failures(plant, states) or obstacles.static_feedback_obstructions(plant)):
        raise InfeasibleError(reasons)
    broken = [error for error in failures if not isinstance(error, NoSolutionError)]
    first, *_ = [*broken, *failures]  # if the path ended early, it is unknown whether the second problem has a solution
    raise type(first)(f"{first} (from {len(failures)} points of the central path)")


@numerics()
def zero_l_design(plant: Plant, lower_bound: KnownBound = None) -> DesignResult:
    """Designs a static gain by (25) with L = 0, without the first step (remark 4 of the paper).

    Raises:
        NoSolutionError: (25) has no solution with L = 0.
        DesignError: no certificate holds.
    """
    plant, independent, kept = independently_measured(plant)
    problem, units = well_posed(plant), own_units(plant, measured=True)
    rows, measured = units.rows(independent.Cy)
    Q = nullspace(rows)
    points = output_feedback(units.into(problem.plant).measured(rows), np.zeros((Q.shape[1], len(kept))), Q)
    path = [point.in_units(units.states, units.inputs, measured) for point in points]
    design = replace(last_certified_gain(independent, path, lower_bound), case=problem.case)
    return with_redundant_rows(design, kept, len(plant.Cy), 0.0)


def independently_measured(plant: Plant) -> tuple[Plant, Plant, list[int]]:
    """Returns the plant without measurement noise, the same plant with only independent rows of C_y, and the row indices."""
    check_inputs(plant)
    plant = plant.measured(plant.Cy)
    kept = independent_rows(plant)
    return plant, plant.rows(kept), kept


def with_redundant_rows(design: DesignResult, kept: Sequence[int], q: int, state_step_gap: float) -> DesignResult:
    """Converts a design for some of q measurements to a design for all q measurements.

    The gain on measurements that the design does not use is zero.
    """
    law = unchecked_static_law(on_all_rows(design.gain, kept, q))
    redundant = tuple(i for i in range(q) if i not in kept)
    return replace(design, law=law, state_step_gap=state_step_gap, redundant=redundant)


def _result(gain: Array, certificate: Certificate, **more: Any) -> DesignResult:
    """Returns a gain and its certificate as a `DesignResult`."""
    return DesignResult(unchecked_static_law(gain), certificate, TWO_STEPS, **more)


def two_steps(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a static gain by the paper's two steps."""
    return two_step_design(problem.plant, None, problem.path(), problem.lower_bound, problem.states)


def state(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs the state feedback of a plant that measures all its states."""
    return state_design(problem.plant, problem.path(), problem.lower_bound)


def zero_l(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a static gain by only the second step (25), with L = 0."""
    return zero_l_design(problem.plant, problem.lower_bound)
