"""Families of candidates, and the search of their numbers on the expectation over the road, by the simplex of Nelder and Mead.

A family has a fixed number of evaluations, so the search finds the same candidates on any machine. MuJoCo has stops, clipped
forces, noise and curves, which the expectation leaves out or makes straight. So the search is repeated with the factors by which
the runs of its best candidate use more of the limits.
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

UNSTABLE = 1e3  # value of a point without a stable loop
STEP, RESTART = 1.0, 0.4  # of the first simplex, and of a repeated search
LARGE_PLANT, FEWER = 7, 0.4  # states; above, families have this share of evaluations
MOST_ALONE = 3  # groups of sensors of which each is tried alone
ORDER = 2  # states for each force of a law of fixed order
PREVIEW_TIME = 0.2  # s, by which the road is known ahead
SKYHOOK = (-0.7, 0.4, -4.0)  # start of its search
LQG_NAME, MARGIN = "LQG", {"gain": 1.02, "disk": 1.02}  # so that rounding does not decide on margins


@dataclass(eq=False)
class Family:
    """Family of candidates that differ in a few numbers.

    Attributes:
        name: name of the family.
        start: point at which the search begins, shape (k,).
        build: function of a point; returns the candidate.
        evaluations: number of evaluated points.
        factors: factors on the use of limits, by which runs in MuJoCo exceed the expectation.
        rated: stable candidates with their ratings and points.
        failure: reason of the last candidate that could not be designed; empty for none.
    """

    name: str
    start: Array
    build: Callable[[Array], Contender]
    evaluations: int
    factors: dict[str, float] = field(default_factory=lambda: dict(MARGIN))
    rated: list[tuple[Contender, Rating, Array]] = field(default_factory=list)
    failure: str = ""

    def best(self, task: Task) -> tuple[Contender, Rating, Array] | None:
        """Returns the best candidate for the present factors; None without any."""
        return min(self.rated, key=lambda one: one[1].penalised(task, self.factors), default=None)

    def weights(self, task: Task, names: Sequence[str]) -> dict[str, float]:
        """Returns the weights of these names of the best candidate, or those of the start."""
        best = self.best(task)
        return dict(zip(names, (self.start if best is None else best[2]).tolist(), strict=True))

    def search(self, task: Task) -> None:
        """Searches for the present factors; a repeated search begins at the best point."""
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
    task: Task,
    name: str,
    measured: Sequence[str],
    evaluations: int,
    start: Weights,
    method: str | int = LQG,
    preview: float = 0.0,
    free: Sequence[str] = (),
) -> Family:
    """Returns the family of optimal laws of some sensors, in which some weights are free, by default all."""
    free = free or [*start]

    def build(x: Array) -> Contender:
        weights = {**start, **dict(zip(free, x.tolist(), strict=True))}
        text = "weights " + ", ".join(f"{key} {brief(float(np.exp(one)))}" for key, one in weights.items() if key != SHARE)
        return Contender(name, design(task, name, measured, weights, method, preview), task.vehicle, text)

    return Family(name, np.array([start[one] for one in free]), build, evaluations)


def families(task: Task) -> Iterator[tuple[Family, tuple[str, ...]]]:
    """Yields the families of a task, the cheap ones first, each with the groups of sensors whose LQG it is or with none.

    A family is to be searched before the next one is taken, whose search begins at its best point.
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
    states = task.line.linear_model.states
    if {*states} <= {*task.sensors}:
        yield optimal_family(task, PREVIEW, states, 20, start, PREVIEW, PREVIEW_TIME), ()
    both = ["force", SHARE]
    full = optimal_family(task, "H-infinity", task.sensors, 24, start | {SHARE: 1.5 * large}, FULL, free=both)
    yield full, ()
    count = ORDER * len(task.forces)
    start |= full.weights(task, both)
    yield optimal_family(task, f"H-inf., {count} states", task.sensors, 8, start, count, free=both), ()
    yield optimal_family(task, "H-inf., static", task.sensors, 6, start, "", free=["force"]), ()
