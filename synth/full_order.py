"""How good output feedback of any order can be: the Gahinet-Apkarian LMIs, their central path, and the bound that it proves.

    minimise t   over (21) for (X, Y, eta), the same for the `observer_plant` for (S11, S12, t), and
                 [S11 N'; N X] > 0,  [eta 1; 1 t] > 0

(`lower_bound.py` derives them and proves the bound). They are followed as in `central.py`, in coordinates where X = S11 = I.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from models.arrays import Array
from models.errors import InputError
from synth.barrier import Barrier, Block, boundary, newton
from synth.central import CENTRED, INSIDE, Basis, CentralPoint, along_path
from synth.limit import invariant_limit
from synth.lower_bound import LowerBound, Witness, lower_bound, meeting, observer_plant, reduced_plant
from synth.plant import GeneralizedPlant
from synth.scaling import size
from synth.state_feedback import state_feedback
from synth.threads import one_thread

STATE_END = 1e-5  # mu over eta; the bound for state feedback is then within (2 n + d) mu / 2 of the best
ENOUGH = 1e-8  # relative; closer to what state feedback reaches no bound need be
END = 1e-6  # mu over t; the bound is then within (2 n + d + n - q) mu / 2 of the best
ENTER = 1e2  # mu over t at the entry of the joint path, which starts far from its centre
ENTRY = 0.1  # mu over eta from which a point of the separate paths is near enough to start from


@one_thread()
def best_possible(plant: GeneralizedPlant, Cy: Array | None = None, path: Sequence[CentralPoint] = ()) -> LowerBound:
    """A norm that no controller reaches: the larger of what the dual proves and of what no control force changes.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n): the bound is for output feedback from y = C_y x, of any order. Without it, for state feedback and more.
        path: of `state_feedback` of the plant, if it is there already.

    Returns:
        The bound; 0 with no witness where nothing is proved.
    """
    gamma, at = invariant_limit(plant)
    best = LowerBound(gamma, limit_at=at)
    reduced = reduced_plant(plant)
    if reduced is not plant or not path:
        path = _as_far_as_it_goes(reduced)
    if not path or best.gamma < path[-1].gamma * (1 - ENOUGH):
        proofs = (
            lower_bound(plant, Witness(point.X, point.K, point.eta)) for point in reversed(path) if point.mu > 0.5 * STATE_END
        )
        best = max(
            best, next((proof for proof in proofs if proof.gamma), best), key=lambda bound: bound.gamma
        )  # the sharpest is first
    if Cy is None or not path:
        return best
    # Where the observer's problem has no solution, or none at a finite gain, there is nothing to add.
    with contextlib.suppress(InputError, np.linalg.LinAlgError), np.errstate(all="ignore"):
        for state, observer in _walk(plant, Cy, min(path, key=lambda point: abs(np.log(point.mu / ENTRY)))):
            found = lower_bound(plant, state, Cy, observer)
            best = found if found.gamma > best.gamma else best
    return best


def _as_far_as_it_goes(plant: GeneralizedPlant) -> list[CentralPoint]:
    """The path of (22), also where its end cannot be reached."""
    n, points = len(plant.A), []
    if n:  # where every state is steered at no cost nothing is proved
        with contextlib.suppress(InputError, np.linalg.LinAlgError), np.errstate(all="ignore"):
            for point in along_path(plant, np.zeros((n, 0)), np.eye(n), STATE_END):
                points.append(point)  # one by one: what was found before an error counts
    return points


def _walk(plant: GeneralizedPlant, Cy: Array, point: CentralPoint) -> Iterator[tuple[Witness, Witness]]:
    """Pairs of witnesses along the joint path, ever closer to the optimum, until it ends or cannot be followed."""
    # Units of time and of w in which A and eta have size one.
    rate, unit = size(plant.A), point.eta**0.5
    plant = GeneralizedPlant(plant.A / rate, plant.B / rate, plant.Bw * unit / rate, plant.C, plant.D, plant.Dw * unit)
    observer = observer_plant(plant, Cy)
    if not len(observer.A):
        return
    # With more noise than there is, so that there is some: what is feasible then is so without.
    noise = np.hstack([observer.Bw, max(size(observer.Bw), 1.0) * np.eye(len(observer.A))])
    noisy = replace(observer, Bw=noise, Dw=np.hstack([observer.Dw, np.zeros((len(observer.C), len(observer.A)))]))
    other = state_feedback(noisy, ENTRY)[-1]
    first = _Side(reduced_plant(plant), point.X / rate, point.K)
    second = _Side(observer, other.X / other.eta, other.K)
    # S and t grow together until [S11 N'; N X] > 0 and eta t > 1.
    fits = float(np.linalg.norm(meeting(plant, Cy, second.T, first.T), 2)) ** 2
    grow = 2 * max(1.0, fits, other.eta)
    second.T *= grow**0.5
    eta, t = 0.9, grow / other.eta
    mu = ENTER * t
    while True:
        one, two = first.basis(), second.basis()
        k = one.size
        barrier = Barrier(_blocks(one, two, meeting(plant, Cy, second.T, first.T)))
        p = np.concatenate([one.pack(np.eye(one.n), 0 * first.K, eta), two.pack(np.eye(two.n), 0 * second.K, t)])
        c = np.zeros(len(p))
        c[-1] = 1 / mu
        p, decrement, here = newton(barrier, p, c, CENTRED)
        if decrement > 0.5:
            return
        X, Y, eta = one.unpack(p[:k])
        S, L, t = two.unpack(p[k:])
        yield first.witness(X, Y, eta * unit**2, rate), second.witness(S / t, L / t, unit**2 / t, unit**2 / rate)
        if mu <= END * t:
            return
        ratio = 0.1 if mu > 1e-2 * t else 1e-2
        c[-1] *= -1
        step = here.solve(here.half(c))
        p = p + min(1 - ratio, INSIDE * boundary(here, step)) * step
        mu *= ratio
        X, Y, eta = one.unpack(p[:k])
        S, L, t = two.unpack(p[k:])
        first.move_to(X, Y)
        second.move_to(S, L)


class _Side:
    """A plant and where its X stands: X = T T', in coordinates in which it is I and the gain K is absorbed."""

    def __init__(self, plant: GeneralizedPlant, X: Array, K: Array) -> None:
        self.plant, self.K, self.T = plant, K, np.linalg.cholesky(X)

    def basis(self) -> Basis:
        return Basis.of(self.plant.closed_loop(self.K).in_coordinates(self.T), 0)

    def witness(self, X: Array, Y: Array, eta: float, unit: float) -> Witness:
        return Witness(self.T @ X @ self.T.T * unit, self.K + Y @ np.linalg.inv(self.T @ X), eta)

    def move_to(self, X: Array, Y: Array) -> None:
        self.K = self.K + Y @ np.linalg.inv(self.T @ X)
        self.T = self.T @ np.linalg.cholesky(X)


def _blocks(one: Basis, two: Basis, coupling: Array) -> list[Block]:
    """The four constraints over the unknowns (X, Y, eta, S11, S12, t)."""
    n, a = one.n, two.n

    def all_unknowns(first: Array | None, second: Array | None) -> Array:
        size = len((first if first is not None else second)[0])  # pyright: ignore[reportOptionalSubscript]
        first = np.zeros((one.size, size, size)) if first is None else first
        second = np.zeros((two.size, size, size)) if second is None else second
        return np.concatenate([first, second])

    # In the observer's inequality t multiplies -I, and its disturbance stands alone.
    observer = two.F.copy()
    observer[-1] = two.F0
    X, S = np.zeros((one.size, a + n, a + n)), np.zeros((two.size, a + n, a + n))
    X[:, a:, a:], S[:, :a, :a] = one.X, two.X
    joint = np.zeros((a + n, a + n))
    joint[:a, a:], joint[a:, :a] = coupling, coupling.T
    etas, ts = np.zeros((one.size, 2, 2)), np.zeros((two.size, 2, 2))
    etas[-1, 0, 0] = ts[-1, 1, 1] = 1
    return [
        (-one.F0, all_unknowns(-one.F, None)),
        (-two.F[-1], all_unknowns(None, -observer)),
        (joint, all_unknowns(X, S)),
        (np.array([[0.0, 1.0], [1.0, 0.0]]), all_unknowns(etas, ts)),
    ]
