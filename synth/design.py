"""A design with its certificate, for any plant: state feedback, and the two steps from where on the path they lead to a gain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from synth.certificate.bounding import certify_tightly
from synth.certificate.certificate import FASTEST, Certificate, certify
from synth.certificate.lower_bound import LowerBound
from synth.errors import DesignError, InfeasibleError
from synth.lmi.central import FIRST, CentralPoint, fits, unknowns
from synth.lmi.output_feedback import independent_rows, l_matrix, nullspace, output_feedback
from synth.lmi.state_feedback import state_feedback
from synth.modes import immovable, obstacles
from synth.numerics import numerics
from synth.plant import Feedback, GeneralizedPlant, measurement_matrix
from synth.posed import free_force, posed, standing
from synth.scaling import own_units

MOST = 1100  # unknowns of (22), 45 states with one input: the second problem is solved from several X, in a minute or less
SAME = 1e-9  # relative: how far rounding takes a gain from one that is made of measurements


@dataclass(frozen=True, eq=False)
class Design:
    """A certified gain u = K y.

    Attributes:
        gain: K, shape (m, q).
        certificate: what is true of it.
        state_step_gap: how far from the optimum of (22), relative in gamma, the X was taken that L (14) comes from: 0 at the
            limit of the central path, more where the second problem is infeasible from there.
        optimum_gap: how far from the optimum of its own problem, relative in gamma, the gain was taken: 0 at the limit, more
            where the optimum is reached only by gains beyond any actuator.
        redundant: rows of C_y that follow from others, by index; their gain is zero.
        case: what is the case where (22) has no optimum, or every gain is one, in words; else empty.
        instead: how else the gain was found, and why the two steps did not lead to one, in words; empty where they did.
        moved: how far the gain still moved from the point of its path before, relative to its largest entry: about a hundred
            times what is left to the limit. It is at most 4e-5 for the cars that ship, and as much for the two steps of a chain
            of 40 states; but the state feedback of chains of 26 and 40 still grows a hundredfold as mu falls as much. Of such a
            gain the norm is proved, and no digit is that of the optimum.
    """

    gain: Array
    certificate: Certificate
    state_step_gap: float = 0.0
    optimum_gap: float = 0.0
    moved: float = 0.0
    redundant: tuple[int, ...] = ()
    case: str = ""
    instead: str = ""


@numerics()
def state_path(plant: GeneralizedPlant, states: Sequence[str] = ()) -> list[CentralPoint]:
    """The central path of (22), or of the problem beside it where that has no optimum (`posed.py`), in the plant's own units.

    Args:
        plant: n states, m inputs.
        states: names of the states, for messages.

    Raises:
        InfeasibleError: the plant cannot be stabilised; the message names the mode.
        DesignError: there is no path, as where z does not see an integrator or a force costs nothing, and the message says why,
            or it could not be followed.
    """
    problem, own = posed(plant).plant, own_units(plant)
    modes = standing(problem, states)
    if modes:  # a path without an end may be followed for a while
        if reached_by_none := "; ".join(obstacles(plant, None, states)):
            raise InfeasibleError(reached_by_none)
        raise DesignError(modes[0])
    try:
        return [point.in_units(own.states, own.inputs, own.states) for point in state_feedback(own.into(problem))]
    except InfeasibleError as error:
        raise InfeasibleError("; ".join(obstacles(plant, None, states)) or str(error)) from error
    except DesignError as error:
        raise type(error)("; ".join(free_force(plant)) or str(error)) from error


@numerics()
def state_design(
    plant: GeneralizedPlant, path: Sequence[CentralPoint] = (), lower_bound: LowerBound | None = None, states: Sequence[str] = ()
) -> Design:
    """State feedback, the optimum of (22).

    Args:
        plant: n states, m inputs.
        path: of `state_path`, if it is there already.
        lower_bound: what no controller of this kind can beat, for the certificate.
        states: names of the states, for messages.

    Raises:
        InfeasibleError, DesignError: as `state_path`, or no certificate holds.
    """
    problem, everything = posed(plant), np.eye(len(plant.A))
    if problem.best is not None:
        return Design(problem.best, certify_tightly(plant, problem.best, lower_bound), case=problem.best_case)
    return replace(furthest(plant, everything, path or state_path(plant, states), lower_bound), case=problem.case)


def furthest(plant: GeneralizedPlant, Cy: Array, path: Sequence[CentralPoint], lower_bound: LowerBound | None = None) -> Design:
    """The gain furthest along a central path whose certificate holds, short of those beyond any actuator.

    Where every proof is of a gain beyond them, as with a plant that hardly moves by itself, the slowest stands for the plant.

    Raises:
        DesignError: no certificate holds.
    """
    first: Certificate | None = None
    # Where a path begins depends on how it was entered; from FIRST on it rests at the same points from wherever.
    alike = [i for i, point in enumerate(path) if point.mu < 2 * FIRST]
    for which in (alike, [i for i in range(len(path)) if i not in alike]):
        beyond: list[Design] = []
        for i in reversed(which):
            point = path[i]
            X = point.X if point.proof is None else point.proof
            certificate = certify(plant, Feedback(point.K, Cy), X, point.eta, lower_bound)
            if not certificate.failures:
                before = path[max(i - 1, 0)].K
                moved = float(np.abs(point.K - before).max(initial=0.0) / (np.abs(point.K).max(initial=0.0) or 1.0))
                design = Design(point.K, certificate, optimum_gap=point.gamma / path[-1].gamma - 1, moved=moved)
                if not certificate.beyond_actuators:
                    return design
                beyond.append(design)
            first = first or certificate
        if beyond:
            slowest = min(design.certificate.speed_up for design in beyond)
            return next(design for design in beyond if design.certificate.speed_up <= FASTEST * slowest)
    if first is None:
        raise DesignError("its certificate fails: the path has no point")
    # The path's own X may lie too near the edge of what can be proved in floating point, as at 40 states; another one need not.
    another = certify_tightly(plant, Feedback(path[-1].K, Cy), lower_bound)
    if another.bound is not None and not another.failures:
        return Design(path[-1].K, another)
    raise DesignError(f"its certificate fails: {'; '.join(first.failures)}")


@numerics()
def two_step_design(
    plant: GeneralizedPlant,
    Cy: Array,
    path: Sequence[CentralPoint] = (),
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
) -> Design:
    """The paper's two steps: L (14) from the X of (22), then (25).

    From the optimal X the second problem can be infeasible where from a point a little short of it it is not: then X comes from
    there. All is done in the plant's own units, so that rounding is the same in whatever units it is given.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n). Rows that follow from others are left out, and said in the result.
        path: of (22), if it is there already.
        lower_bound: what no controller of this kind can beat, for the certificate.
        states: names of the states, for messages.

    Raises:
        InputError: C_y does not fit the plant, or is empty.
        InfeasibleError: the plant cannot be stabilised from y, or (25) is infeasible from every X tried; the message says which.
        TooLargeError: (22) has more than MOST unknowns.
        DesignError: from some X a path broke off, or no certificate holds.
    """
    Cy, kept = measurement(plant, Cy)
    problem = posed(plant)
    units = own_units(plant, Cy)
    rows, measured = units.rows(Cy[kept])
    if problem.best is not None:
        G = problem.best * units.states
        on_rows = G @ rows.T
        if np.linalg.norm(on_rows @ rows - G) <= SAME * np.linalg.norm(G):
            K = np.linalg.solve(measured.T, on_rows.T).T
            best = Design(K, certify_tightly(plant, Feedback(K, Cy[kept]), lower_bound), case=problem.best_case)
            return widened(best, kept, len(Cy), 0.0)
    fits(unknowns(problem.plant), MOST, "the two steps are gone")
    path = path or state_path(plant, states)
    own, Q = units.into(problem.plant), nullspace(rows)
    failures: list[DesignError] = []
    beyond: list[Design] = []
    for start in reversed(path):
        try:
            L = l_matrix(start.X / np.outer(units.states, units.states), rows, Q)
            points = [point.in_units(units.states, units.inputs, measured) for point in output_feedback(own, rows, L, Q)]
            found = furthest(plant, Cy[kept], points, lower_bound)
        except DesignError as error:
            failures.append(error)
            continue
        found = widened(replace(found, case=problem.case), kept, len(Cy), start.gamma / path[-1].gamma - 1)
        if not found.certificate.beyond_actuators:
            return found
        beyond.append(found)
    if beyond:
        return min(beyond, key=lambda design: design.certificate.speed_up)
    if reasons := "; ".join(obstacles(plant, Cy, states) or immovable(plant, Cy)):
        raise InfeasibleError(reasons)
    broken = [error for error in failures if not isinstance(error, InfeasibleError)]
    first, *_ = [*broken, *failures]  # only where all are infeasible it is proved that there is none
    raise type(first)(f"{first} (from {len(failures)} points of the central path)")


@numerics()
def zero_l_design(plant: GeneralizedPlant, Cy: Array, lower_bound: LowerBound | None = None) -> Design:
    """Remark 4: (25) with L = 0, in one step.

    Raises:
        InputError, InfeasibleError, DesignError: as `two_step_design`.
    """
    Cy, kept = measurement(plant, Cy)
    problem, units = posed(plant), own_units(plant, Cy)
    rows, measured = units.rows(Cy[kept])
    Q = nullspace(rows)
    points = output_feedback(units.into(problem.plant), rows, np.zeros((Q.shape[1], len(kept))), Q)
    path = [point.in_units(units.states, units.inputs, measured) for point in points]
    return widened(replace(furthest(plant, Cy[kept], path, lower_bound), case=problem.case), kept, len(Cy), 0.0)


def measurement(plant: GeneralizedPlant, Cy: Array) -> tuple[Array, list[int]]:
    """C_y, checked, and which of its rows do not follow from those before them.

    Raises:
        InputError: see `measurement_matrix`.
    """
    Cy = measurement_matrix(Cy, len(plant.A))
    return Cy, independent_rows(plant, Cy)


def widened(design: Design, kept: Sequence[int], q: int, state_step_gap: float) -> Design:
    """A design from some of q measurements as one from all of them, with a gain of zero for the others."""
    gain = np.zeros((len(design.gain), q))
    gain[:, kept] = design.gain
    return replace(design, gain=gain, state_step_gap=state_step_gap, redundant=tuple(i for i in range(q) if i not in kept))
