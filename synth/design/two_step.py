"""A design with its certificate, for any plant: state feedback, and the two steps from where on the path they lead to a gain.

Some plants leave problem (22) without an optimum, or every gain one; beside each stands a problem that has one:

- **w does not reach z**, or some gain keeps it out: a norm of 0 is reached, and eta has no bound. Then every state that z sees is
  disturbed by itself, too.
- **No control force reaches z**: the norm is the same for all gains. Then every state and every force counts, too.

The gain is certified for the plant as it is: an X that proves a bound with more disturbances and outputs proves it with fewer.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.document.document import Document
from models.document.text import Shown, facts
from models.laws.linear import gain_text
from synth.analysis.certificate import FASTEST, Certificate, certify
from synth.analysis.lower_bound import LowerBound
from synth.analysis.stability import balance, is_stable, pole_text
from synth.lmi.central_path import CentralPoint, fits, unknowns
from synth.lmi.output_feedback import independent_rows, l_matrix, nullspace, output_feedback, state_feedback
from synth.lmi.unobservable import RANK, output_nulling_gains, output_nulling_subspace, remove_unobservable
from synth.plant.generalized import Feedback, Plant, check_inputs, check_states, on_all_rows
from synth.plant.numerics import DesignError, InfeasibleError, NoSolutionError, numerics
from synth.plant.units import own_units, size

INSTEAD = "designed for a disturbance of every state that z contains"


@dataclass(frozen=True, eq=False)
class WellPosedProblem:
    """A well-posed problem (22).

    Attributes:
        plant: plant to design for: the given plant, unless its problem is degenerate.
        case: degeneracy of the given problem, in words, or empty.
        best: an optimal state gain, shape (m, n), if one is known.
        best_case: degeneracy that makes that gain optimal, in words.
    """

    plant: Plant
    case: str = ""
    best: Array | None = None
    best_case: str = ""

    def __post_init__(self) -> None:
        if self.best is not None:
            self.best.flags.writeable = False


@functools.lru_cache(maxsize=2)  # both steps of a design ask for it, and plants do not change
def well_posed(plant: Plant) -> WellPosedProblem:
    """Returns the problem (22) of a plant, or a regularised one if it is degenerate; neither depends on units.

    Raises:
        InputError: the plant has no state.
    """
    check_states(len(plant.A))
    plant = plant.unmeasured
    if not (np.any(plant.Bw) or np.any(plant.Dw)) or not (np.any(plant.C) or np.any(plant.D)):
        return WellPosedProblem(plant)  # bad input, and the central path says so
    scale, forces = own_units(plant).exact
    step, form = plant.dt or 0.0, plant.differences
    own, nothing = form.in_coordinates(np.diag(scale)).with_inputs(np.diag(forces)), np.zeros_like(plant.B.T)
    blind = output_nulling_subspace(own, nothing)[1]  # what z does not see without control
    alone = nothing if is_stable(plant.A, plant.dt) else None
    strength = size(own.Bw) * (plant.dt or 1.0)
    everything = _counting(_disturbed(plant, strength * np.diag(scale)), own, scale, forces)

    if not np.any(plant.D) and not _leaves(own.B, blind):
        text = "no control force affects z, so its norm is the same for every gain"
        return WellPosedProblem(everything, f"{text} that stabilises the plant", alone, f"{text}; no force is applied")

    kept, rest, F = _seen(own, step)
    direct = bool(np.any(plant.Dw))
    if len(rest.A) and (direct or _leaves(own.Bw, blind, kept @ rest.Bw)):
        return WellPosedProblem(plant)
    beside = _disturbed(plant, strength * scale[:, None] * kept) if len(rest.A) else everything
    how = "affects z only through Dw" if direct else "does not affect z"
    if not _leaves(own.Bw, blind):
        text = f"without control w {how}"
        return WellPosedProblem(beside, f"{text}, but the plant is not stable; {INSTEAD}", alone, f"{text}; no force is applied")
    best = forces[:, None] * F / scale
    stable = is_stable(plant.closed_loop(best).A, plant.dt)
    text = f"with the right state feedback w {how}; {INSTEAD}"
    return WellPosedProblem(beside, text, best if stable else None, f"with this gain w {how}")


def unpenalised_inputs(plant: Plant) -> list[str]:
    """Returns a message if a control force costs nothing, as (22) then has no optimum; empty otherwise."""
    step, plant = plant.dt or 0.0, own_units(plant).into(plant.differences)
    _, rest, _ = _seen(plant.in_coordinates(np.diag(balance(plant.A)[1])), step)
    W = rest.independent_inputs()
    rank = int(np.linalg.matrix_rank(rest.D @ W, RANK * size(rest.D))) if W.shape[1] else 0
    if rank < W.shape[1]:
        return [
            f"z weights only {rank} of {W.shape[1]} independent control forces, so that nothing limits the optimal gain; give "
            "every control force a weight"
        ]
    return []


def unobservable_marginal_modes(plant: Plant, states: Sequence[str] = ()) -> list[str]:
    """Returns a message on the slowest undamped mode that z does not observe, as (22) then has no optimum; empty without one."""
    dt, plant = plant.dt, own_units(plant).into(plant.differences)
    scale = balance(plant.A)[1]
    balanced, names = plant.in_coordinates(np.diag(scale)), list(states) or [f"x{i + 1}" for i in range(len(plant.A))]
    for F in output_nulling_gains(balanced):
        V, A = output_nulling_subspace(balanced, F)[1], balanced.closed_loop(F).A
        poles, vectors = np.linalg.eig(V.T @ A @ V) if V.shape[1] else (np.zeros(0), V)
        rounding = RANK * size(A)
        if dt is None:
            still = [
                (abs(pole.imag) if abs(pole.imag) > rounding else 0.0, vector)
                for pole, vector in zip(poles, vectors.T, strict=True)
                if abs(pole.real) <= rounding
            ]
        else:  # |1 + dt pole| = 1
            still = [
                (pole if abs(pole) > rounding else 0.0, vector)
                for pole, vector in zip(poles, vectors.T, strict=True)
                if abs(pole.real + dt * abs(pole) ** 2 / 2) <= rounding
            ]
        if still:  # the slowest of them: which comes first is rounding's choice
            at, vector = min(still, key=lambda pair: abs(pair[0]))
            from synth.analysis.stability import largest

            where = complex(0.0, at.real) if dt is None else complex(1 + dt * at)
            return [
                f"z does not contain the mode at {pole_text(where, dt)}, which does not decay and appears most in "
                f"{largest(scale * (V @ vector), names)}, so the optimal loop is not stable; weight a signal that contains this "
                "mode, or remove the mode from the model"
            ]
    return []


def _seen(plant: Plant, step: float) -> tuple[Array, Plant, Array]:
    """Returns coordinates (n, k) and plant of the part that `unseen` leaves for (22), and the gain that hides the rest."""
    kept, parts = np.eye(len(plant.A)), []
    while (part := remove_unobservable(plant, np.zeros((len(plant.A), 0)), np.eye(len(plant.A)), step)) is not None:
        kept, plant, parts = kept @ part.Z[:, : len(part.rest.A)], part.rest, [*parts, part]
    F = np.zeros_like(plant.B.T)
    for part in reversed(parts):
        F = part.gain(F)
    return kept, plant, F


def _leaves(inputs: Array, inside: Array, what: Array | None = None) -> bool:
    """Returns True if inputs drive states outside a subspace, or if their given part `what` is not zero."""
    outside = inputs - inside @ (inside.T @ inputs) if what is None else what
    return bool(np.any(np.linalg.norm(outside, axis=0) > RANK * np.linalg.norm(inputs, axis=0)))


def _disturbed(plant: Plant, where: Array) -> Plant:
    """Returns the plant with an additional disturbance for each column of `where`, acting on the states."""
    Bw, Dw = np.hstack([plant.Bw, where]), np.hstack([plant.Dw, np.zeros((len(plant.C), where.shape[1]))])
    return replace(plant, Bw=Bw, Dw=Dw)


def _counting(plant: Plant, own: Plant, scale: Array, forces: Array) -> Plant:
    """With every state and every input in z, each in its own size, where the plant itself is `own`."""
    n, m = plant.B.shape
    weight = size(own.C)
    states, inputs = weight * np.diag(1 / scale), weight * size(own.B) / size(own.A) * np.diag(1 / forces)
    C = np.vstack([plant.C, states, np.zeros((m, n))])
    D = np.vstack([plant.D, np.zeros((n, m)), inputs])
    return replace(plant, C=C, D=D, Dw=np.vstack([plant.Dw, np.zeros((n + m, plant.Dw.shape[1]))]))


LARGEST_GAIN = 1e5  # of |K_ij| where a search has no bound of its own
MOST = 1100  # unknowns of (22), 45 states with one input: the second problem is solved from several X, in a minute or less
NO_GAIN = "no static gain found"
SAME = 1e-9  # relative: how far rounding takes a gain from one that is made of measurements


def no_gain(tried: str, more: str = "") -> str:
    """Returns a message for a search that found no stabilising static gain: what to do, then what was tried."""
    return f'{NO_GAIN}; measure more signals, {more}or give order = "full", a law with states (tried: {tried})'


@dataclass(frozen=True, eq=False, repr=False)
class Design(Shown):
    """A certified gain u = K y.

    Attributes:
        gain: K, shape (m, q).
        certificate: certificate of its loop.
        state_step_gap: relative distance in gamma from the optimum of (22) at which X for L (14) was taken: 0 at the limit of the
            central path, more if the second problem is infeasible from there.
        optimum_gap: relative distance in gamma of the gain from the optimum of its own problem: 0 at the limit, more if only
            gains beyond any actuator reach the optimum.
        redundant: rows of C_y that follow from others, by index; their gain is zero.
        case: degeneracy of (22) (no optimum, or every gain optimal), in words, or empty.
        instead: the fallback method and why the two steps found no gain, in words, or empty.
        moved: last change of the gain along its path, relative to its largest entry: about a hundred times the distance to the
            limit. It is at most 4e-5 for the built-in cars, and for the two steps of a chain of 40 states. But the state feedback
            of chains of 26 and 40 states still grows a hundredfold as mu falls as much. The norm of such a gain is proved, but
            none of its digits is that of the optimum.
    """

    gain: Array
    certificate: Certificate
    state_step_gap: float = 0.0
    optimum_gap: float = 0.0
    moved: float = 0.0
    redundant: tuple[int, ...] = ()
    case: str = ""
    instead: str = ""

    @property
    def shown(self) -> Document:
        """Returns gain and certificate as a document."""
        proved = self.certificate.shown
        words = {"case": self.case, "instead": self.instead}
        return facts(f"design, {proved.title}", {"gain": gain_text(self.gain), **self.certificate.claims, **words})


@numerics()
def state_path(plant: Plant, states: Sequence[str] = ()) -> list[CentralPoint]:
    """Returns the central path of (22), or of a regularised problem if that has no optimum, in the plant's own units.

    Raises:
        InfeasibleError: the plant cannot be stabilised; the message names the mode.
        DesignError: there is no path, for example because z does not see an integrator or a force costs nothing, or the path
            could not be followed; the message gives the reason.
    """
    plant = plant.unmeasured
    problem, own = well_posed(plant).plant, own_units(plant)
    modes = unobservable_marginal_modes(problem, states)
    if modes:  # a path without an end may be followed for a while
        from synth.analysis.stability import stabilisability_failures

        if reached_by_none := "; ".join(stabilisability_failures(plant, states)):
            raise InfeasibleError(reached_by_none)
        raise DesignError(modes[0])
    try:
        return [point.in_units(own.states, own.inputs, own.states) for point in state_feedback(own.into(problem))]
    except NoSolutionError as error:
        from synth.analysis.stability import stabilisability_failures

        if reasons := "; ".join(stabilisability_failures(plant, states)):
            raise InfeasibleError(reasons) from error
        raise
    except DesignError as error:
        raise type(error)("; ".join(unpenalised_inputs(plant)) or str(error)) from error


@numerics()
def state_design(plant: Plant, path: Sequence[CentralPoint] = (), lower_bound: LowerBound | None = None) -> Design:
    """Returns the state feedback, the optimum of (22).

    Args:
        path: path of `state_path`, if known.
        lower_bound: lower bound of the norm over all controllers of this kind, for the certificate.

    Raises:
        InfeasibleError, DesignError: errors of `state_path`, or no certificate holds.
    """
    problem, measured = well_posed(plant), plant.measured(np.eye(len(plant.A)))
    if problem.best is not None:
        from synth.analysis.bounding import certify_tightly

        return Design(problem.best, certify_tightly(plant, problem.best, lower_bound), case=problem.best_case)
    return replace(last_certified_gain(measured, path or state_path(plant), lower_bound), case=problem.case)


def last_certified_gain(plant: Plant, path: Sequence[CentralPoint], lower_bound: LowerBound | None = None) -> Design:
    """The gain furthest along a central path whose certificate holds, short of those beyond any actuator.

    Where every proof is of a gain beyond them, as with a plant that hardly moves by itself, the slowest stands for the plant.

    Raises:
        DesignError: no certificate holds.
    """
    first: Certificate | None = None
    beyond: list[Design] = []
    for i in reversed(range(len(path))):
        point = path[i]
        X = point.X if point.proof is None else point.proof
        certificate = certify(plant, Feedback(point.K, plant.Cy), X, point.eta, lower_bound)
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
    from synth.analysis.bounding import certify_tightly

    # The path's own X may lie too near the edge of what can be proved in floating point, as at 40 states; another one need not.
    another = certify_tightly(plant, Feedback(path[-1].K, plant.Cy), lower_bound)
    if another.bound is not None and not another.failures:
        return Design(path[-1].K, another)
    raise DesignError(f"its certificate fails: {'; '.join(first.failures)}")


@numerics()
def two_step_design(
    plant: Plant,
    Cy: Array | None = None,
    path: Sequence[CentralPoint] = (),
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
) -> Design:
    """Returns the static gain of the paper's two steps, with its certificate: L (14) from the X of (22), then (25).

    The second problem (25) can be infeasible from the optimal X, and feasible from a point of the central path shortly before it.
    Then that point gives X. The plant is scaled to its own units first, so that the result does not depend on the given ones.

    Args:
        plant: n states, m inputs.
        Cy: measurements y = C_y x, shape (q, n); the plant's own by default. The result lists rows that depend on others.
        path: the central path of (22); computed if empty.
        lower_bound: lower bound of the norm over all controllers of this kind, for the certificate.
        states: names of the states, for messages.

    Raises:
        InputError: C_y does not fit the plant, or is empty.
        InfeasibleError: no static gain from y stabilises the plant; the message names the mode.
        TooLargeError: (22) has more than MOST unknowns.
        DesignError: (25) has no solution from any X tried, from some X a path broke off, or no certificate holds; there may be
            a gain nevertheless.

    Example:
        >>> from synth import GeneralizedPlant, two_step_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = two_step_design(oscillator, Cy=[[0, 1]])
        >>> design.gain.shape, f"{design.certificate.norm.value:.4f}", design.certificate.failures
        ((1, 1), '0.2500', ())
    """
    plant, few, kept = independently_measured(plant if Cy is None else plant.measured(Cy))
    problem, q = well_posed(plant), len(plant.Cy)
    units = own_units(plant, measured=True)
    rows, measured = units.rows(few.Cy)
    if problem.best is not None:
        G = problem.best * units.states
        on_rows = G @ rows.T
        if np.linalg.norm(on_rows @ rows - G) <= SAME * np.linalg.norm(G):
            from synth.analysis.bounding import certify_tightly

            K = np.linalg.solve(measured.T, on_rows.T).T
            best = Design(K, certify_tightly(few, Feedback(K, few.Cy), lower_bound), case=problem.best_case)
            return with_redundant_rows(best, kept, q, 0.0)
    fits(unknowns(problem.plant), MOST, "the two-step method")
    path = path or state_path(plant, states)
    own, Q = units.into(problem.plant).measured(rows), nullspace(rows)
    failures: list[DesignError] = []
    beyond: list[Design] = []
    for start in reversed(path):
        try:
            L = l_matrix(start.X / np.outer(units.states, units.states), rows, Q)
            points = [point.in_units(units.states, units.inputs, measured) for point in output_feedback(own, L, Q)]
            found = last_certified_gain(few, points, lower_bound)
        except DesignError as error:
            failures.append(error)
            continue
        found = with_redundant_rows(replace(found, case=problem.case), kept, q, start.gamma / path[-1].gamma - 1)
        if not found.certificate.beyond_actuators:
            return found
        beyond.append(found)
    if beyond:
        return min(beyond, key=lambda design: design.certificate.speed_up)
    from synth.analysis.stability import stabilisability_failures, static_feedback_obstructions

    if reasons := "; ".join(stabilisability_failures(plant, states) or static_feedback_obstructions(plant)):
        raise InfeasibleError(reasons)
    broken = [error for error in failures if not isinstance(error, NoSolutionError)]
    first, *_ = [*broken, *failures]  # only where none has a solution that is the reason
    raise type(first)(f"{first} (from {len(failures)} points of the central path)")


@numerics()
def zero_l_design(plant: Plant, lower_bound: LowerBound | None = None) -> Design:
    """Remark 4: (25) with L = 0, in one step."""
    plant, few, kept = independently_measured(plant)
    problem, units = well_posed(plant), own_units(plant, measured=True)
    rows, measured = units.rows(few.Cy)
    Q = nullspace(rows)
    points = output_feedback(units.into(problem.plant).measured(rows), np.zeros((Q.shape[1], len(kept))), Q)
    path = [point.in_units(units.states, units.inputs, measured) for point in points]
    design = replace(last_certified_gain(few, path, lower_bound), case=problem.case)
    return with_redundant_rows(design, kept, len(plant.Cy), 0.0)


def independently_measured(plant: Plant) -> tuple[Plant, Plant, list[int]]:
    """Returns a plant that measures y = C_y x alone, the same with independent rows, and the indices of these rows."""
    check_inputs(plant)
    plant = plant.measured(plant.Cy)
    kept = independent_rows(plant)
    return plant, plant.rows(kept), kept


def with_redundant_rows(design: Design, kept: Sequence[int], q: int, state_step_gap: float) -> Design:
    """A design from some of q measurements as one from all of them, with a gain of zero for the others."""
    gain = on_all_rows(design.gain, kept, q)
    return replace(design, gain=gain, state_step_gap=state_step_gap, redundant=tuple(i for i in range(q) if i not in kept))
