"""LQR, LQG and H2: controllers with the smallest mean square of z, for comparison with H-infinity controllers.

The disturbance w is white noise of intensity one, and the root mean square of z is the H2 norm of the loop. If all states are
measured, the controller is a gain (LQR). With noisy measurements, the LQR gain acts on the state estimate of a Kalman filter.
No linear controller has a smaller mean square (separation theorem; Anderson, Moore 1990, Optimal Control, chapters 2, 7 and 8).

LQG and H2 are the same problem. For LQG, the noise of each measurement is given separately; for H2, z and y belong to a
generalised plant. If a measurement has no noise, or a force has no cost, the problem is singular. A small noise or cost,
relative to the plant's internal units, is then assumed, and the result contains a remark about this assumption. Noise and cost
that the caller gives are used unchanged, even if they are small. Inputs and measurements are scaled so that their size is one
and the Riccati equations contain no small numbers. An integral that is measured without noise is not estimated by the Kalman
filter, because it only acts on z.

The direct effect of white noise on z through Dw has an infinite mean square. No control changes this direct effect, so the
effect is omitted.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw, static_law
from synth.analysis.bounding import certify_law
from synth.analysis.stabilisability import stabilisability_failures
from synth.analysis.stability import balance, is_stable
from synth.design.problem import H2_NORM, DesignProblem, DesignResult, Progress
from synth.plant.generalized import Plant, check_inputs, check_posed, real_matrix
from synth.plant.normalised import NormalisedPlant
from synth.plant.numerics import DesignError, InfeasibleError, numerics
from synth.plant.units import independent, own_units

AT_ONCE = ", without its direct effect on z, whose power is infinite"
# assumed noise of a measurement without noise, and assumed cost of a force without cost, in the plant's internal units
ASSUMED_SIZE = 1e-2
NOTHING = 1e-13  # a value smaller than this is zero up to rounding, in the plant's internal units
LITTLE = 1e-6  # a noise or weight below this value may be the reason why a design fails, in the plant's internal units


def lqr_design(plant: Plant, states: Sequence[str] = ()) -> DesignResult:
    """Designs the state feedback u = K x that minimises the mean square of z.

    The gain K is the same for every disturbance matrix `Bw`.

    Args:
        plant: generalised plant with n states and m inputs.
        states: names of the states, used in error messages.

    Returns:
        The law u = K x with K of shape (m, n), its certificate, and its H2 norm.

    Raises:
        InputError: the plant has no state or disturbance, or z is zero.
        InfeasibleError: the plant cannot be stabilised; the message describes the mode that cannot be stabilised.
        DesignError: a mode that does not decay is unobservable in z.

    Example:
        >>> from synth import GeneralizedPlant, lqr_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = lqr_design(oscillator)
        >>> design.law.D.round(3)
        array([[-6.77 , -3.581]])
    """
    return _design(plant.measured(np.eye(len(plant.A))), states, True)


def lqg_design(
    plant: Plant, Cy: Array | None = None, noise: Sequence[float] | None = None, states: Sequence[str] = ()
) -> DesignResult:
    """Designs the controller that measures y = C_y x + v, where v is independent white noise, and minimises the mean square of
    z.

    Args:
        plant: generalised plant with n states and m inputs.
        Cy: measurement matrix, shape (q, n). Default: the Cy of the plant.
        noise: noise intensity of each measurement, shape (q,), in [unit of the measurement times sqrt(s)]. If noise with rms
            sigma is drawn every T seconds, its intensity is sigma sqrt(T). Since w has intensity one, the columns of B_w and
            D_w must be multiplied by the square root of the disturbance's true intensity. Default: a small noise is assumed,
            and the result has a remark.
        states: names of the states, used in error messages.

    Returns:
        A law with as many states as the plant, its certificate, and its H2 norm.

    Raises:
        InputError: C_y or the noise does not fit the plant, or `lqr_design` raises this type of error.
        InfeasibleError: no controller stabilises the plant from the measurements; the message describes the mode that cannot be
            stabilised.
        DesignError: w does not excite a mode that does not decay, or `lqr_design` raises this type of error.

    Example:
        >>> from synth import GeneralizedPlant, lqg_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = lqg_design(oscillator, Cy=[[0, 1]], noise=[0.01])
        >>> design.law.states, f"{design.h2_norm:.4f}"
        (2, '0.1955')
    """
    plant = plant.measured(plant.Cy if Cy is None else Cy)
    if noise is None:
        return h2_design(plant, states=states)
    q = len(plant.Cy)
    sizes = real_matrix([list(noise)], "noise", f"(1, {q})")[0]
    if sizes.shape != (q,) or np.any(sizes < 0):
        raise InputError(f"noise has shape {sizes.shape}; give {q} numbers of at least 0, one for each measurement")
    return _design(plant, states, False, np.diag(sizes))


def h2_design(plant: Plant, Cy: Array | None = None, Dyw: Array | None = None, states: Sequence[str] = ()) -> DesignResult:
    """Designs the controller that measures y = C_y x + Dyw w and minimises the H2 norm from w to z.

    Args:
        plant: generalised plant with n states, m inputs and r disturbances.
        Cy: measurement matrix, shape (q, n). Default: the Cy of the plant.
        Dyw: direct effect of w on the measurements, shape (q, r). Default: zero if Cy is given, otherwise the Dyw of the plant.
        states: names of the states, used in error messages.

    Returns:
        A law with as many states as the plant, its certificate, and its H2 norm.

    Raises:
        InputError, InfeasibleError, DesignError: `lqg_design` raises this type of error.

    Example:
        >>> from synth import GeneralizedPlant, h2_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = h2_design(oscillator, Cy=[[0, 1]])
        >>> f"{design.h2_norm:.4f}"
        '0.1908'
    """
    return _design(plant.measured(Cy, Dyw), states, False)


def quadratic(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs the law that minimises the mean square of z, by `lqr_design`, `lqg_design` or `h2_design`.

    Raises:
        DesignError: LQR was requested, but not every state is measured.
        InputError, InfeasibleError, DesignError: `lqr_design`, `lqg_design` or `h2_design` raises this type of error.
    """
    plant, states = problem.plant, problem.states
    if problem.design == "lqr":
        plant = plant.measured(plant.Cy)
        rows = state_rows(plant)
        result = lqr_design(plant, states)
        result = replace(result, law=on_rows(result.law, plant.Cy, rows))
    else:
        result = lqg_design(plant, None, problem.noise, states) if problem.design == "lqg" else h2_design(plant, states=states)
    return replace(result, certificate=replace(result.certificate, below=problem.lower_bound))


def state_rows(plant: Plant) -> list[int]:
    """Returns the indices of n independent measurements, where n is the number of states.

    Raises:
        DesignError: not every state is measured.
    """
    rows, n = independent(plant.Cy * own_units(plant, measured=True).states), len(plant.A)
    if len(rows) < n:
        raise DesignError(
            f"LQR feeds back all {n} states, but only {len(rows)} are measured (states of filters in [performance] never are); "
            'give design = "lqg" or "h2", or order = "full", or constant weights'
        )
    return rows


def on_rows(law: LinearLaw, Cy: Array, kept: Sequence[int]) -> LinearLaw:
    """Converts a gain on the state to a gain on measurements y = C_y x.

    `kept` contains the indices of the measurements to which the new gain applies; see `state_rows`.
    """
    gain = np.zeros((len(law.D), len(Cy)))
    gain[:, kept] = np.linalg.solve(Cy[kept].T, law.D.T).T
    return static_law(gain)


def h2_norm(loop: Plant) -> float:
    """Returns the root mean square of z for white noise w in a stable loop, without the direct effect of w through Dw."""
    A, scale = balance(loop.A)
    Bw, C = loop.Bw / scale[:, None], loop.C * scale
    covariance = linalg.solve_continuous_lyapunov(A, -Bw @ Bw.T)
    return float(np.sqrt(max(np.trace(C @ covariance @ C.T), 0.0)))


@numerics()
def lqg_law(plant: Plant, noise: Sequence[float]) -> LinearLaw:
    """Returns the same law as `lqg_design`, but without checks, norm and certificate, for use in a search over the weights of
    z.

    Args:
        plant: generalised plant with n states and q measurements.
        noise: noise intensity of each measurement, as in `lqg_design`.

    Raises:
        DesignError: a Riccati equation has no solution.
    """
    own = NormalisedPlant.of(plant.with_disturbances(np.diag(noise)))
    Dyw_T = np.delete(own.plant.Dyw, list(_known_states(own.plant)), axis=0).T
    law, _ = _law(own, False, _assumed_rows(own.plant.D)[0], _assumed_rows(Dyw_T)[0])
    return law


@numerics()
def _design(plant: Plant, states: Sequence[str], all_known: bool, noise: Array | None = None) -> DesignResult:
    """Designs the law that minimises the mean square of z. `value` of the result is the H2 norm.

    The H2 norm is computed for the plant without regularisation and without Dw, for white noise w and the noise of LQG.
    The certificate applies to the worst-case w. The certificate excludes the noise of LQG, because white noise has no finite rms.

    Args:
        noise: feedthrough from additional white noise to y, shape (q, k); this noise affects only the mean square.
    """
    check_inputs(plant)
    shaken = plant if noise is None else plant.with_disturbances(noise)
    check_posed(shaken)
    if reasons := "; ".join(stabilisability_failures(plant, states)):
        raise InfeasibleError(reasons)
    own = NormalisedPlant.of(shaken)
    Dyw_T = np.delete(own.plant.Dyw, list(_known_states(own.plant)), axis=0).T
    (cost, least_cost), (unheard, least_noise) = _assumed_rows(own.plant.D), _assumed_rows(Dyw_T)
    least = min(least_cost, np.inf if all_known else least_noise)
    try:
        law, assumed = _law(own, all_known, cost, unheard * (not all_known))
        certificate = certify_law(plant, law)
        if certificate.failures:
            raise DesignError(f"its certificate fails: {'; '.join(certificate.failures)}")
    except DesignError as error:
        if least >= LITTLE:
            raise
        what = "noise of a measurement" if least < least_cost else "cost of a force"
        raise DesignError(
            f"{error}; the smallest {what} is {least:.1g} of the plant's own size, perhaps too small for floating point: give "
            f"more, or omit it to use {100 * ASSUMED_SIZE:g} %"
        ) from error
    share = f"{100 * ASSUMED_SIZE:g} % of the plant's own size was assumed where they are missing"
    remark = f"this design needs {' and '.join(assumed)}; {share}" if assumed else ""
    method = "a Riccati equation" if all_known else "two Riccati equations"
    value, remarks = h2_norm(shaken.closed(law)), (remark,) if remark else ()
    return DesignResult(law, certificate, method, remarks=remarks, value=value, criterion=H2_NORM)


def _assumed_rows(D: Array) -> tuple[Array, float]:
    """Returns extra rows for D that raise its zero singular values to `ASSUMED_SIZE`, and the smallest nonzero singular value
    of D.

    Args:
        D: matrix with a column for each input, shape (d, m).

    Returns:
        The extra rows, shape (k, m), and the smallest nonzero singular value; infinite if all singular values are zero.
    """
    _, sizes, directions = np.linalg.svd(D)
    sizes = np.concatenate([sizes, np.zeros(D.shape[1] - len(sizes))])
    there = sizes > NOTHING * max(1.0, sizes.max(initial=0.0))
    return ASSUMED_SIZE * directions[~there], float(sizes[there].min(initial=np.inf))


def _law(own: NormalisedPlant, all_known: bool, cost: Array, unheard: Array) -> tuple[LinearLaw, list[str]]:
    """Returns the optimal law for a plant with assumed force costs and measurement noises, and texts that describe these
    assumptions.

    Raises:
        DesignError: a Riccati equation has no solution.
    """
    plant = own.plant
    assumed = ["a cost of every force"] if len(cost) else []
    K = _regulator(plant, cost, "z does not contain a mode that neither decays nor grows; weight a signal that contains it")
    if all_known:
        return own.back(static_law(K @ np.linalg.inv(plant.Cy))), assumed
    unreached = "w does not disturb a mode that neither decays nor grows; add a disturbance of this mode"
    known = _known_states(plant)
    rest, states = np.delete(np.arange(len(plant.Cy)), list(known)), np.delete(np.arange(len(plant.A)), list(known.values()))
    A, B, Cy = plant.A[np.ix_(states, states)], plant.B[states], plant.Cy[np.ix_(rest, states)]
    part = plant.unchecked(A=A, B=B, Bw=plant.Bw[states], C=plant.C[:, states], Cy=Cy, Dyu=plant.Dyu[rest], Dyw=plant.Dyw[rest])
    L = _regulator(part.transposed, unheard, unreached).T
    assumed += ["noise on every measurement"] if len(unheard) else []
    into, direct = np.zeros((len(A), len(plant.Cy))), np.zeros((len(K), len(plant.Cy)))
    into[:, rest] = -L
    for row, state in known.items():
        direct[:, row] = K[:, state] / plant.Cy[row, state]
        into[:, row] = B @ direct[:, row]
    return own.back(LinearLaw(A + B @ K[:, states] + L @ Cy, into, K[:, states], direct)), assumed


def _known_states(plant: Plant) -> dict[int, int]:
    """Returns the states that affect only z and are measured without noise, as {index of the measurement: index of the state}."""
    known = {}
    for row, (states, noise) in enumerate(zip(plant.Cy, plant.Dyw, strict=True)):
        (there,) = np.nonzero(states)
        if len(there) == 1 and not np.any(noise) and not np.any(plant.A[:, there[0]]):
            known[row] = int(there[0])
    return known


def _stabilising_solution(A: Array, B: Array, Q: Array, R: Array, S: Array) -> Array:
    """Returns the solution X of a regulator's Riccati equation.

    SciPy's balancing may fail if slow modes are close to the imaginary axis.

    Raises:
        LinAlgError, ValueError: no solution was found, with or without balancing.
    """
    try:
        return linalg.solve_continuous_are(A, B, Q, R, s=S)
    except (np.linalg.LinAlgError, ValueError):
        return linalg.solve_continuous_are(A, B, Q, R, s=S, balanced=False)


def _regulator(plant: Plant, more: Array, advice: str) -> Array:
    """Returns the gain K, shape (m, n), for which u = K x minimises the mean square of [C x + D u; `more` u]."""
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    if not B.shape[1]:  # no force has any effect
        return np.zeros((0, len(A)))
    turned, sizes, directions = np.linalg.svd(np.vstack([D, more]), full_matrices=False)
    each = directions.T / sizes  # combinations of inputs whose cost is one, without cross terms
    B, D = B @ each, turned[: len(D)]
    try:
        X = _stabilising_solution(A, B, C.T @ C, np.eye(len(sizes)), C.T @ D)
        K = -B.T @ X - D.T @ C
    except (np.linalg.LinAlgError, ValueError) as error:
        raise DesignError(f"a Riccati equation has no stabilising solution: {advice}") from error
    if not is_stable(A + B @ K):
        raise DesignError(f"a Riccati equation has no solution that stabilises the loop despite rounding: {advice}")
    return each @ K
