"""Choice of the design methods for a problem, and `design`, which runs the methods.

A method is a function in its own file, and a row in `EXTENSIONS` of `models.common.extensions`:

    def method(problem: DesignProblem, progress: Progress) -> DesignResult

A method raises an InputError, for example a DesignError, if it finds no controller.
"""

import contextlib
from dataclasses import replace

import numpy as np

from models.common.errors import InputError
from models.common.extensions import FEATURES, METHODS
from models.common.printed import digits, percent, rough
from models.laws.design_methods import FULL
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable
from synth.design.problem import H2_NORM, LARGEST_GAIN, SEEN, TWO_STEPS, DesignProblem, DesignResult, Progress, quiet
from synth.plant.numerics import InfeasibleError, numerics

# if the filters have states, the result of the two steps is accepted if its relative gap to the lower bound is smaller than
# this
FAR = 0.01
KNOW_NO_NOISE = "the two-step method ignores measurement noise"
# largest number of states for which a lower bound is computed automatically; with more states, the computation takes minutes
LARGEST_BOUNDED = 20


def choose(problem: DesignProblem) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns two lists of methods: methods that are tried until one succeeds, and methods that then continue from the result."""
    if problem.method:
        return (problem.method,), ()
    if problem.errors is not None:
        tries, further = choose(replace(problem, errors=None))
        return tries, (*further, "mu")
    if problem.sampled is not None:
        return ("sampled",), ()
    if problem.structure is not None:
        return ("structured",), ()
    if problem.goals is not None:
        return ("goals",), ()
    if problem.design:
        return (problem.design,), ()
    static = "two_steps", "descent"
    if problem.order == FULL:
        free = problem.alternatives and not problem.stable and problem.fastest_pole is None
        return ("riccati", *(("h2", *static) if free else ())), ("descent",)
    return static, ("descent", "refinement") if problem.alternatives else ("descent",)


def insufficient(problem: DesignProblem, steps: DesignResult) -> str:
    """Returns the reason why descent must follow the two steps, as text; empty if no descent is needed.

    The two steps ignore noise. The two steps compute the gain from the matrix X of problem (22). The state feedback of problem
    (22) uses every state, including filter states that y does not contain and that no control changes. With filters, descent
    therefore continues from the gain of the two steps. Descent also continues if the norm of the loop is larger than the norm
    without control.
    """
    plant, certificate = problem.plant, steps.certificate
    norm = certificate.norm.value
    if steps.method != TWO_STEPS:
        return ""
    if np.any(plant.Dyw):
        return KNOW_NO_NOISE
    entry = float(np.abs(steps.gain).max(initial=0.0))
    if problem.largest_gain < LARGEST_GAIN and entry > problem.largest_gain:
        return f"the two-step method needs a gain of {rough(entry)}, but {problem.largest_gain:g} is the largest allowed"
    if plant.weights and ((gap := certificate.gap) is None or gap > FAR):
        far = f", {percent(gap)} above the lower bound" if gap is not None else ""
        return f"the two-step method ends at {digits(norm)}{far}: its X needs filter states, which y lacks"
    if is_stable(plant.A, plant.dt) and (passive := hinf_norm(plant).value) < norm * (1 - SEEN):
        return f"the two-step method ends at {digits(norm)}, above {digits(passive)} without control"
    return ""


@numerics()
def design(problem: DesignProblem, progress: Progress = quiet) -> DesignResult:
    """Designs a controller by the methods that `choose` selects for a problem.

    Args:
        progress: function that is called with the smallest value of the goal so far, and with True if all bounds are fulfilled.

    Raises:
        InfeasibleError: no controller of the required type stabilises the plant; the message describes the mode that cannot be
            stabilised.
        DesignError: no method found a controller; the message gives the reason.
    """
    tries, further = (tuple(name for name in names if name in METHODS) for names in choose(problem))
    if "descent" in further and problem.order != FULL:
        problem = _possible(problem)
    failures: list[Exception] = []
    for name in tries:
        try:
            problem = problem.starting(METHODS.load(name)(problem, progress))
            break
        except (InputError, np.linalg.LinAlgError) as error:
            if isinstance(error, InfeasibleError) and not failures:
                raise
            failures.append(error)
            problem = replace(problem, failure=error)
    if problem.start is None:
        assert failures, "a method returns a result"
        raise failures[0] if problem.order == FULL else failures[-1]
    for name in further:
        if name == "descent" and problem.start is not None and not insufficient(problem, problem.start):
            continue
        problem = problem.starting(METHODS.load(name)(problem, progress))
    assert problem.start is not None, "a method returns a result"
    return _instead_of_riccati(problem, problem.start, failures[0]) if failures and problem.order == FULL else problem.start


def _possible(problem: DesignProblem) -> DesignProblem:
    """Returns the design problem of a static gain, to which a lower bound is added unless the plant has too many states.

    Raises:
        InfeasibleError: no static gain stabilises the plant; the message describes the mode that cannot be stabilised.
    """
    if not is_stable(problem.plant.A, problem.plant.dt):
        FEATURES.load("obstacles to stabilisation").check_stabilisable(problem.plant, problem.states)
    if problem.alternatives and problem.lower_bound is None and len(problem.plant.A) <= LARGEST_BOUNDED:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            return replace(problem, lower_bound=FEATURES.load("lower bounds").find_lower_bound(problem.plant))
    return problem


def _instead_of_riccati(problem: DesignProblem, result: DesignResult, failure: Exception) -> DesignResult:
    """Returns the result of the method that replaced the Riccati equations, with the reason for the replacement."""
    certificate = replace(result.certificate, below=problem.lower_bound)
    why = f"Riccati equations for the least norm failed: {failure}"
    method = "H2, of full order" if result.criterion == H2_NORM else result.method
    return DesignResult(result.law, certificate, method, why)
