"""Families of candidates, and the Nelder-Mead search for the candidates' parameters, based on the expected metrics on the road.

The number of evaluations for a family is fixed, so that the search finds the same candidates on any computer. MuJoCo simulates
bump stops, clipped forces, noise and nonlinear characteristics, which the expected metrics neglect or linearise. In MuJoCo, the
best candidate may therefore come closer to a limit than expected, or may exceed the limit. If a limit is exceeded or not fully
used, the search is repeated with a corrected limit. The correction factor is the share of the limit that the candidate used in
MuJoCo, divided by the expected share.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from string import ascii_lowercase

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import brief
from models.laws.design_methods import FULL, PREVIEW
from sim.studies.recommend.laws import body_sensors, changed_passive, skyhook
from sim.studies.recommend.optimal import LQG, SHARE, USUAL, Weights, design, searched
from sim.studies.recommend.rating import Rating, rate_expected
from sim.studies.recommend.task import Contender, Task
from synth.plant.numerics import DesignError

UNSTABLE = 1e3  # value that the search assigns to a law whose loop is not stable
STEP, RESTART = 1.0, 0.4  # size of the first simplex, and of the simplex with which a repeated search starts
# if the plant has more states than LARGE_PLANT, the search does only the share FEWER of its evaluations
LARGE_PLANT, FEWER = 7, 0.4
MOST_ALONE = 3  # if there are at most this many sensor groups, each group is also tried alone
ORDER = 2  # number of states per force of a fixed-order law
SKYHOOK = (-0.7, 0.4, -4.0)  # point at which the search for a skyhook law starts
# Name of the LQG law; safety factors that multiply the required margins, so that rounding does not decide whether a law keeps
# them
LQG_NAME, MARGIN = "LQG", {"gain": 1.02, "disk": 1.02}


@dataclass(eq=False)
class Family:
    """A family of candidates, which differ only in the values of a few parameters.

    Attributes:
        name: name of the family in the table.
        start: point in parameter space at which the search begins, shape (k,).
        build: function that returns the candidate for a point in parameter space.
        evaluations: number of points that one search evaluates.
        factors: ratio of the used share in MuJoCo to the expected share, by name of the limit.
        rated: candidates with a stable loop, each with its rating and its point in parameter space.
        failure: reason why the last failed candidate could not be designed; empty if no design failed.
    """

    name: str
    start: Array
    build: Callable[[Array], Contender]
    evaluations: int
    factors: dict[str, float] = field(default_factory=lambda: dict(MARGIN))
    rated: list[tuple[Contender, Rating, Array]] = field(default_factory=list)
    failure: str = ""

    def best(self, task: Task) -> tuple[Contender, Rating, Array] | None:
        """Returns the best candidate under the present correction `factors`; None if there is no candidate."""
        return min(self.rated, key=lambda one: one[1].penalised(task, self.factors), default=None)

    def weights(self, task: Task, names: Sequence[str]) -> dict[str, float]:
        """Returns the named weights of the best candidate; if there is no candidate, those of the starting point."""
        best = self.best(task)
        return dict(zip(names, (self.start if best is None else best[2]).tolist(), strict=True))

    def search(self, task: Task) -> None:
        """Searches for the best candidate under the present correction `factors`. A repeated search begins at the best point of
        the earlier search.
        """
        from scipy import optimize

        def value(x: Array) -> float:
            try:
                candidate = self.build(x)
                rating = rate_expected(task, candidate)
            except (DesignError, InputError, np.linalg.LinAlgError) as error:
                self.failure = str(error)
                return UNSTABLE
            if rating is None:
                self.failure = self.failure or "the implemented loop is unstable"
                return UNSTABLE
            self.rated.append((candidate, rating, np.array(x)))
            return min(rating.penalised(task, self.factors), UNSTABLE)

        best = self.best(task)
        start, step = (self.start, STEP) if best is None else (best[2], RESTART)
        few = len(task.line.linear_model.states) > LARGE_PLANT
        count = max(2, round(task.effort * self.evaluations * (FEWER if few else 1.0) * (1.0 if best is None else 0.4)))
        simplex = np.vstack([start, start + step * np.eye(len(start))])
        options = {"maxfev": count, "initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-4}
        optimize.minimize(value, start, method="Nelder-Mead", options=options)


def optimal_family(
    task: Task, name: str, measured: Sequence[str], evaluations: int, start: Weights, method: str | int = LQG, free: str = ""
) -> Family:
    """Returns the family of optimal laws for the measured sensors; `free` lists the weights that the search varies, by default
    all.
    """
    names = free.split() or [*start]

    def build(x: Array) -> Contender:
        weights = {**start, **dict(zip(names, x.tolist(), strict=True))}
        text = "weights " + ", ".join(f"{key} {brief(float(np.exp(one)))}" for key, one in weights.items() if key != SHARE)
        return Contender(name, design(task, name, measured, weights, method), task.vehicle, text)

    return Family(name, np.array([start[one] for one in names]), build, evaluations)


def families(task: Task) -> Iterator[tuple[Family, tuple[str, ...]]]:
    """Yields the families of a task; families with a short computing time come first. The second item of each pair lists the
    sensor groups of a family of LQG laws; for any other family, this item is empty.

    The caller must search each family before requesting the next one, because later families begin at the best points of
    earlier families.
    """
    yield Family("best damper", np.zeros(1), lambda x: changed_passive(task, "best damper", x.tolist()), 14), ()
    yield Family("damper, spring", np.zeros(2), lambda x: changed_passive(task, "damper, spring", x.tolist()), 30), ()
    sensors = body_sensors(task)
    if sensors is not None:
        size, usual = 3 if sensors.accelerations else 1, np.array(SKYHOOK)

        def sky(name: str, x: Array, travel: bool) -> Contender:
            return skyhook(task, sensors, name, [*x[:size], *usual[size:], *x[size:]], travel)

        plain = Family("skyhook", usual[:size], lambda x: sky("skyhook", x, False), 50)
        yield plain, ()
        if any(sensors.travels):
            best = plain.best(task)
            start = np.concatenate([usual[:size] if best is None else best[2], np.zeros(2)])
            yield Family("skyhook+travel", start, lambda x: sky("skyhook+travel", x, True), 80), ()
    groups, large = task.groups, len(task.line.linear_model.states) > LARGE_PLANT
    whole = optimal_family(task, LQG_NAME, task.sensors, 150, {name: USUAL[name] for name in searched(task)})
    yield whole, tuple(groups)
    start = whole.weights(task, searched(task))
    alone = [(name,) for name in groups] if len(groups) <= MOST_ALONE else []
    for some in dict.fromkeys([*alone, *(tuple(one for one in groups if one != name) for name in groups)]):
        if 0 < len(some) < len(groups):
            name = f"{LQG_NAME}, {''.join(letter for letter, one in zip(ascii_lowercase, groups, strict=False) if one in some)}"
            yield optimal_family(task, name, [signal for one in some for signal in groups[one]], 80, start), some
    states, both = task.line.linear_model.states, f"force {SHARE}"
    if {*states} <= {*task.sensors}:
        yield optimal_family(task, PREVIEW, states, 20, start, PREVIEW), ()
    full = optimal_family(task, "H-infinity", task.sensors, 24, start | {SHARE: 1.5 * large}, FULL, both)
    yield full, ()
    count = ORDER * len(task.forces)
    start |= full.weights(task, both.split())
    yield optimal_family(task, f"H-inf., {count} states", task.sensors, 8, start, count, both), ()
    yield optimal_family(task, "H-inf., static", task.sensors, 6, start, "", "force"), ()
