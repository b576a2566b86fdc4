"""The COMPleib plants (Leibfritz), one row each, from a file that is not part of this repository.

    python -m tests.benchmarks.compleib PLANTS.json [--dt SECONDS] [--json] [--only NAME...]

PLANTS.json maps names to the matrices of x' = A x + B1 w + B u, z = C1 x + D11 w + D12 u, y = C x + D21 w. Plants with D21 != 0
are left out: the two-step method needs y = C x. The refined norm is the complete strategy's, with gains bounded by 1e5, confirmed
by both routes and proved by the bound beside it. The gap is what it leaves to a lower bound for controllers of any order; `from`
names the start that led to the gain.

With --dt each plant is sampled, its u and w held for so many seconds, and designed as a discrete plant: all numbers are then
those of the discrete norm. What a force held so long cannot stabilise has no gain.

A lower bound of 0 has no gap. Of AC1, NN10 and UWV the gain beside it reaches 0, to rounding. Of PAS and ROC5 none is above it: y
and its derivatives show the whole state, and the norm of an LQ state feedback falls with the root of the force's weight. Of ROC4
and ROC10 only their zeros in the right half plane count: stable or undamped zeros leave the full-order LMIs no point inside.
"""

import functools
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

# One thread per process: the matrices are small, and there is a process for every core. Before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg

from models.common.errors import InputError
from synth.design.problem import LARGEST_GAIN
from synth.design.static import static_output_feedback
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError

MATRICES = ("A", "B", "B1", "C1", "D12", "D11", "C", "D21")


@dataclass(frozen=True)
class Row:
    """One plant's row, as `--json` has it."""

    plant: str
    states: int
    seconds: float
    cpu_seconds: float
    lower_bound: float | None = None
    two_step_bound: float | None = None
    two_step_norm: float | None = None
    norm: float | None = None
    bound: float | None = None
    gap: float | None = None
    origin: str | None = None
    starts: int | None = None
    gain: list[list[float]] | None = None
    remarks: tuple[str, ...] = ()
    reason: str | None = None


def solve(task: tuple[str, dict[str, Any]], dt: float | None = None) -> Row:
    """The row of one plant, held over dt if that is given. Whatever fails is its reason: others must not lose their rows."""
    name, data = task
    start, cpu_start = time.perf_counter(), time.process_time()
    found: dict[str, Any] = {}
    try:
        for part in _findings(data, dt):
            found |= part
    except Exception as error:
        found["reason"] = str(error) if isinstance(error, DesignError | InputError) else f"{type(error).__name__}: {error}"
    return Row(name, len(data["A"]), time.perf_counter() - start, time.process_time() - cpu_start, **found)


def _findings(data: dict[str, Any], dt: float | None) -> Iterator[dict[str, Any]]:
    """Cells of a row, as they are found."""
    A, B, Bw, C, D, Dw, Cy = (np.array(data[key], dtype=float) for key in MATRICES[:-1])
    plant = GeneralizedPlant(A, B, Bw, C, D, Dw)
    plant = plant if dt is None else held(plant, dt)
    lower_bound = find_lower_bound(plant, Cy)
    yield {"lower_bound": lower_bound.gamma}
    design = static_output_feedback(plant, Cy, LARGEST_GAIN, lower_bound)
    certificate = design.certificate
    yield {"gain": design.gain.tolist(), "origin": design.origin, "starts": design.starts, "remarks": certificate.remarks}
    if design.two_steps is not None:
        by_two_steps = design.two_steps.certificate
        yield {"two_step_bound": by_two_steps.bound, "two_step_norm": by_two_steps.norm.value}
    if certificate.failures:
        raise DesignError("; ".join(certificate.failures))
    yield {"norm": certificate.norm.value, "bound": certificate.bound, "gap": certificate.gap}


def read_tasks(path: str, only: list[str]) -> list[tuple[str, dict[str, Any]]]:
    """The plants of the file that the method applies to, in its order; the largest are begun first elsewhere."""
    try:
        plants = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error}); give the file of the COMPleib plants") from error
    for name in only:
        if name not in plants:
            raise InputError(f"unknown plant {name!r}; {path} has {', '.join(plants)}")
    for name, data in plants.items():
        missing = [key for key in MATRICES if key not in data]
        if missing:
            raise InputError(f"{path}: plant {name!r} has no {', '.join(missing)}; a plant has {', '.join(MATRICES)}")
    return [(name, data) for name, data in plants.items() if not np.any(data["D21"]) and (not only or name in only)]


def held(plant: GeneralizedPlant, dt: float) -> GeneralizedPlant:
    """The discrete plant of a continuous one whose u and w are held over dt [s]."""
    n, inputs = len(plant.A), np.hstack([plant.B, plant.Bw])
    k, m = inputs.shape[1], plant.B.shape[1]
    moved = linalg.expm(dt * np.block([[plant.A, inputs], [np.zeros((k, n + k))]]))
    return GeneralizedPlant(moved[:n, :n], moved[:n, n : n + m], moved[:n, n + m :], plant.C, plant.D, plant.Dw, dt=dt)


def line(row: Row) -> str:
    """One row of the table."""

    def number(value: float | None) -> str:
        return f"{value:.7g}" if value is not None else "-"

    largest = f"{np.abs(row.gain).max():.3g}" if row.gain is not None else "-"
    gap = f"{100 * row.gap:.2g} %" if row.gap is not None else "-"
    bounds = (number(value) for value in (row.two_step_bound, row.two_step_norm, row.norm, row.bound, row.lower_bound))
    cells = (*bounds, gap, largest, f"{row.seconds:.1f}")
    return (
        f"{row.plant:10s} {row.states:6d} "
        + " ".join(f"{cell:>14s}" for cell in cells)
        + "  "
        + "; ".join([*([f"from {row.origin}"] if row.origin else []), *row.remarks, *([row.reason] if row.reason else [])])
    )


def _seconds(words: list[str]) -> float:
    """Returns what stands behind --dt.

    Raises:
        InputError: no number of seconds above zero does.
    """
    try:
        dt = float(words[0])
    except (IndexError, ValueError):
        dt = 0.0
    if not 0 < dt < np.inf:
        raise InputError(f"--dt {' '.join(words)} is not a sample period; give seconds above 0, such as --dt 0.02")
    return dt


def main(arguments: list[str]) -> int:
    """The command; 1 if a plant is left without a certified gain."""
    as_json = "--json" in arguments
    words = [word for word in arguments if word != "--json"]
    dt = None
    if "--dt" in words:
        at = words.index("--dt")
        dt, words = _seconds(words[at + 1 : at + 2]), words[:at] + words[at + 2 :]
    if "--only" in words:
        at = words.index("--only")
        words, only = words[:at], words[at + 1 :]
    else:
        only = []
    if len(words) != 1:
        raise InputError(
            "give one file: python -m tests.benchmarks.compleib PLANTS.json [--dt SECONDS] [--json] [--only NAME...]"
        )
    tasks = read_tasks(words[0], only)
    order = sorted(range(len(tasks)), key=lambda i: -len(tasks[i][1]["A"]))
    start = time.perf_counter()
    rows: dict[str, Row] = {}
    if not as_json:
        headings = ("two-step bound", "two-step norm", "refined norm", "bound", "lower bound", "gap", "largest gain", "seconds")
        print(f"{'plant':10s} {'states':>6s} " + " ".join(f"{heading:>14s}" for heading in headings))
    with multiprocessing.Pool(os.cpu_count()) as pool:
        for row in pool.imap_unordered(functools.partial(solve, dt=dt), [tasks[i] for i in order], chunksize=1):
            rows[row.plant] = row
            if not as_json:
                print(line(row), flush=True)
    done = [rows[name] for name, _ in tasks]
    if as_json:
        print(json.dumps({"plants": [asdict(row) for row in done]}))
    else:
        certified = sum(row.norm is not None for row in done)
        stepped = sum(row.two_step_norm is not None for row in done)
        wall = time.perf_counter() - start
        spent = sum(row.cpu_seconds for row in done)
        print(
            f"\n{certified} of {len(done)} with a certified gain, {stepped} by the two steps alone, {wall:.0f} s; "
            f"{spent:.0f} s of processor time"
        )
    return 0 if all(row.norm is not None for row in done) else 1


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except InputError as error:
        print(f"roadproof: {error}", file=sys.stderr)
        sys.exit(2)
