"""Combinations of parameters that the logs determine, and directions in parameter space along which no signal changes.

The matrix J contains the derivatives of all residuals, and J'J is the information matrix. The columns of J that belong to the
parameters are projected onto the orthogonal complement of the columns of all other unknowns. The singular value decomposition
of the projected columns gives the singular values s. The columns of V are directions in the space of the parameters'
logarithms. If a direction has s = 0, a change of the logarithms along this direction changes no signal. For a quarter-car, one
direction changes no motion: all masses, stiffnesses and dampings are multiplied by a common factor. For each direction with s =
0, one parameter is then fixed at its initial value. For each parameter that is not fixed, the logs determine the product of
this parameter with powers of the fixed parameters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.estimation.residuals import Residuals
from sim.studies.identification.estimation.search import first_unknowns

SINGULAR = 1e-7  # a direction with a smaller relative singular value changes no signal; the matrices are accurate to 1e-10
ZERO = 1e-5  # a component of a direction counts as zero if its magnitude is smaller than this


@dataclass(frozen=True, eq=False)
class Structure:
    """Parameters, and combinations of parameters, that the signals do not determine.

    Attributes:
        held: parameters to hold at their initial values, because the signals determine only products of these parameters with
            others.
        silent: parameters that affect no signal.
        directions: directions along which no signal changes, as components along the logarithms of the parameters, by name.
    """

    held: tuple[str, ...]
    silent: tuple[str, ...]
    directions: tuple[Mapping[str, float], ...] = ()

    def determined(self, free: Sequence[str]) -> dict[str, dict[str, float]]:
        """Returns, for each free parameter, the exponents of the product of this parameter and powers of held parameters that
        the logs determine.
        """
        if not self.directions:
            return {}
        own, held = (np.array([[one.get(name, 0.0) for one in self.directions] for name in names]) for names in (free, self.held))
        # The powers fulfil own = shares @ held, so log(free parameters) - shares @ log(held parameters) is the same for any
        # held values
        shares = np.linalg.solve(held.T, own.T).T
        return {
            name: {name: 1.0, **{other: -_tidy(share) for other, share in zip(self.held, row, strict=True) if _tidy(share)}}
            for name, row in zip(free, shares, strict=True)
        }


def information(R: Array, p: int) -> tuple[Array, Array]:
    """Returns the information on the first p unknowns if all unknowns are estimated, and how other unknowns compensate for
    changes of the first p.

    Args:
        R: derivatives of all residuals with respect to the u unknowns, or the factor R of their QR decomposition, shape (k, u).

    Returns:
        Matrix R, where R'R is the information on the first p unknowns, shape (p, p), and matrix C, shape (u - p, p). The
        product of the remaining columns with C is the part of the first p columns that the remaining columns can also produce.
    """
    own, others = R[:, :p], R[:, p:]
    C = np.linalg.lstsq(others, own)[0] if others.shape[1] else np.zeros((0, p))
    return np.linalg.qr(own - others @ C).R, C


def structure_of(R: Array, free: Sequence[str]) -> Structure:
    """Returns the parameters, and combinations of parameters, that the signals do not determine.

    Args:
        R: derivatives of all residuals with respect to the unknowns at the initial values, or the factor R of the QR
            decomposition of these derivatives. The first columns of R belong to the free parameters. At the initial values, the
            first columns are also the derivatives with respect to the logarithms, even for a parameter that may be zero.
        free: names of the parameters that may be estimated.
    """
    R, _ = information(R, len(free))
    sizes = np.linalg.norm(R, axis=0)
    silent = tuple(name for name, size in zip(free, sizes, strict=True) if size <= SINGULAR * sizes.max(initial=0.0))
    felt = [i for i, name in enumerate(free) if name not in silent]
    if not felt:
        return Structure((), silent)
    _, s, V = np.linalg.svd(R[:, felt] / sizes[felt])
    # To find the rank, the columns are scaled to length 1. The directions found are then converted back to logarithms.
    null = (V[s <= SINGULAR * s[0]] / sizes[felt]).T
    if not null.size:
        return Structure((), silent)
    names, held, rows = [free[i] for i in felt], list[int](), null.copy()
    order = sorted(range(len(names)), key=lambda i: (not names[i].startswith("sprung_mass"), "mass" not in names[i], i))
    for _ in range(null.shape[1]):
        largest = np.abs(rows).max(axis=1)
        pivot = next(i for i in order if i not in held and largest[i] > 0.1 * largest.max())
        held.append(pivot)
        column = int(np.argmax(np.abs(rows[pivot])))
        rows = rows - np.outer(rows[:, column], rows[pivot]) / rows[pivot, column]
    basis = null @ np.linalg.inv(null[held])
    directions = (
        {name: _tidy(power) for name, power in zip(names, column, strict=True) if abs(power) > ZERO} for column in basis.T
    )
    return Structure(tuple(names[i] for i in held), silent, tuple(directions))


def standard_deviations(problem: IdentificationProblem) -> dict[str, float]:
    """Returns the Cramer-Rao bound on the standard deviation of each parameter's logarithm at the initial values.

    The bound is infinite for a parameter that the signals do not determine. The noise of each sensor must be known.
    """
    of = Residuals(problem, tuple(problem.first))
    x = first_unknowns(of)
    R, _ = information(of.reduced(x, of.noise(x))[0], len(of.free))
    sizes = np.linalg.norm(R, axis=0)
    _, s, V = np.linalg.svd(R / np.where(sizes, sizes, 1.0))
    spread = np.sqrt(np.sum((V / np.maximum(s, 1e-300)[:, None]) ** 2, axis=0)) / np.where(sizes, sizes, 1e-300)
    lost = np.abs(V[s <= SINGULAR * s[0]]).max(axis=0, initial=0.0) > ZERO
    return {name: float(one) for name, one in zip(of.free, np.where(lost, np.inf, spread), strict=True)}


def _tidy(number: float) -> float:
    """Returns the nearest multiple of 1/12 if a number equals this multiple apart from rounding errors; otherwise the number
    itself.
    """
    near = round(12 * number) / 12
    return near if abs(near - number) < 1e-4 else float(number)
