"""Search of the weights or numbers of every family, on the exact expectation over the road, by the simplex of Nelder and Mead.

Every family has a fixed number of evaluations, so the search finds the same candidates on any machine. The best candidates of a
family for several shares of stroke and force are driven: MuJoCo has stops and clipped forces, which the expectation leaves out.
The simplex of LQG begins anew for each share, at the best point so far.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from string import ascii_lowercase

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.design_methods import FULL, PREVIEW
from sim.studies.recommend.laws import body_sensors, changed_passive, semi_active, skyhook
from sim.studies.recommend.optimal import LQG, design, searched, usual_point, weights_of
from sim.studies.recommend.rating import Rating, rate_expected
from sim.studies.recommend.task import Candidate, Task
from synth.plant.numerics import DesignError

UNSTABLE = 1e3  # value of a point without a stable loop
STEP, RESTART = 1.0, 0.4  # of the first simplex, and of later ones
LARGE_PLANT = 10  # states; above, families have fewer evaluations
MOST_ALONE = 4  # groups of sensors of which each is tried alone
PREVIEWS = (0.1, 0.3)  # s, by which the road is known ahead
SHARES = (1.0, 0.92, 0.8)  # of stroke and force, for which a family's best candidate is driven
MORE_SHARES = (1.0, 0.85, 0.7, 0.5, 0.35, 0.2)  # of a road that is not random, or of clipped forces


@dataclass(frozen=True, eq=False)
class Family:
    """Family of candidates that differ in a few numbers.

    Attributes:
        name: name of the family.
        start: point at which the search begins, shape (k,).
        build: function of a point; returns the candidate.
        evaluations: number of evaluated points; 1 for the start alone.
        shares: shares of stroke and force for which it is searched, one after the other.
        begin: function of the best point of the family before, or None; returns another start. None to begin at `start`.
    """

    name: str
    start: Array
    build: Callable[[Array], Candidate]
    evaluations: int
    begin: Callable[[Array | None], Array] | None = None
    shares: tuple[float, ...] = (1.0,)


@dataclass(eq=False)
class Search:
    """Candidates of a family that were evaluated.

    Attributes:
        rated: stable candidates with their ratings and points.
        failure: reason of the last candidate that could not be designed; empty for none.
    """

    rated: list[tuple[Candidate, Rating, Array]] = field(default_factory=list)
    failure: str = ""

    def best(self, task: Task, share: float = 1.0) -> tuple[Candidate, Rating, Array] | None:
        """Returns the best candidate for a share of stroke and force that may be used; None without any."""
        return min(self.rated, key=lambda one: one[1].penalised(task, share), default=None)

    def some(self, task: Task, shares: Sequence[float]) -> list[tuple[Candidate, Rating]]:
        """Returns the best candidates for several shares, each once."""
        best = [one for share in shares if (one := self.best(task, share)) is not None]
        return [(one, rating) for i, (one, rating, _) in enumerate(best) if one not in [each for each, *_ in best[:i]]]


def search(task: Task, family: Family, progress: Callable[[str], None]) -> Search:
    """Searches a family.

    Raises:
        KeyboardInterrupt: interrupted; the caller has what earlier families found.
    """
    from scipy import optimize

    found = Search()

    def value(x: Array, share: float = 1.0) -> float:
        try:
            candidate = family.build(x)
            rating = rate_expected(task, candidate)
        except (DesignError, InputError, np.linalg.LinAlgError) as error:
            found.failure = str(error)
            return UNSTABLE
        if rating is None:
            found.failure = found.failure or "the implemented loop is unstable"
            return UNSTABLE
        found.rated.append((candidate, rating, np.array(x)))
        return min(rating.penalised(task, share), UNSTABLE)

    progress(family.name)
    if family.evaluations <= 1 or not len(family.start):
        value(family.start)
        return found
    for share in family.shares:
        best = found.best(task, share)
        start = family.start if best is None else best[2]
        simplex = np.vstack([start, start + (STEP if best is None else RESTART) * np.eye(len(start))])
        options = {"maxfev": family.evaluations // len(family.shares), "initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-4}
        optimize.minimize(value, start, (share,), "Nelder-Mead", options=options)
    return found


def optimal_family(task: Task, name: str, measured: Sequence[str], evaluations: int, start: Array, method: str = LQG) -> Family:
    """Returns the family of optimal laws of some sensors."""

    def build(x: Array) -> Candidate:
        return Candidate(
            name, name, design(task, name, measured, weights_of(task, x), method), task.vehicle, weight_text(task, x)
        )

    return Family(name, start, build, evaluations)


def weight_text(task: Task, x: Sequence[float]) -> str:
    """Returns the weights of a point in words."""
    return "weights " + ", ".join(f"{name} {np.exp(one):.3g}" for name, one in zip(searched(task), x, strict=True))


def families(task: Task) -> Iterator[Family]:
    """Yields the families of a task but those of optimal laws, in the order of their cost."""
    few = len(task.line.linear_model.states) > LARGE_PLANT
    yield Family("best damper", np.zeros(1), lambda x: changed_passive(task, "best damper", x), 16)
    yield Family("damper and spring", np.zeros(2), lambda x: changed_passive(task, "damper and spring", x), 40)
    sensors = body_sensors(task)
    if sensors is None:
        return
    size = 3 if sensors.accelerations else 1
    start = np.array([-0.7, 0.4, -4.0])

    def sky(x: Array, travel: bool = False, name: str = "skyhook") -> Candidate:
        return skyhook(task, sensors, name, [*x[:size], *start[size:], *x[size:]], travel)

    yield Family("skyhook", start[:size], sky, 40 if few else 60)
    if sensors.travels:

        def begin(best: Array | None) -> Array:
            return np.concatenate([start[:size] if best is None else best, np.zeros(2)])

        yield Family("skyhook, travel", begin(None), lambda x: sky(x, True, "skyhook, travel"), 60 if few else 100, begin)


def optimal_laws(task: Task, progress: Callable[[str], None]) -> Iterator[tuple[Family, Search]]:
    """Yields the families of optimal laws of all sensors with their searches: LQG, preview, H-infinity."""
    few, measured = len(task.line.linear_model.states) > LARGE_PLANT, task.sensors
    lqg = optimal_family(task, "LQG", measured, 120 if few else 240, usual_point(task))
    found = search(task, lqg, progress)
    yield lqg, found
    best = found.best(task)
    start = usual_point(task) if best is None else best[2]
    if set(task.line.linear_model.states) <= set(measured):
        for seconds in PREVIEWS:
            name = f"preview {seconds:g} s"

            def ahead(x: Array, name: str = name, seconds: float = seconds) -> Candidate:
                law = design(task, name, task.line.linear_model.states, weights_of(task, x), PREVIEW, seconds)
                return Candidate(name, "preview", law, task.vehicle, weight_text(task, x))

            one = Family(name, start, ahead, 12 if few else 24)
            yield one, search(task, one, progress)
    for name, method, count in (("H-infinity", FULL, 3 if few else 10), ("H-infinity, static", "", 3 if few else 6)):
        one = optimal_family(task, name, measured, count, start, method)
        yield one, search(task, one, progress)


def sensor_families(task: Task, start: Array | None) -> Iterator[tuple[tuple[str, ...], Family]]:
    """Yields LQG with fewer sensors, by groups of sensors: each group alone, and all but one group.

    Args:
        start: point at which the searches begin; None for the usual one.
    """
    groups, few = task.groups, len(task.line.linear_model.states) > LARGE_PLANT
    alone = [(name,) for name in groups] if len(groups) <= MOST_ALONE else []
    subsets = dict.fromkeys([*alone, *(tuple(one for one in groups if one != name) for name in groups)])
    for some in subsets:
        if some and len(some) < len(groups):
            name = f"LQG, {''.join(letter for letter, one in zip(ascii_lowercase, groups, strict=False) if one in some)}"
            measured = [signal for one in some for signal in groups[one]]
            begin = usual_point(task) if start is None else start
            yield some, optimal_family(task, name, measured, 60 if few else 150, begin)


def semi_active_laws(task: Task) -> list[Candidate]:
    """Returns the semi-active laws; empty for a vehicle without adjustable dampers."""
    return semi_active(task) if task.vehicle.dampers else []
