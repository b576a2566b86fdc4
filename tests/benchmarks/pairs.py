"""Ratios of two works that take turns in one process, so that a slow minute of the machine slows both."""

import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np

Call = Callable[[], object]


def seconds(call: Call, clock: Callable[[], float] = time.perf_counter) -> float:
    """Returns how long a call takes [s]."""
    start = clock()
    call()
    return clock() - start


def paired_ratio(
    benchmark, call: Call, reference: Call, rounds: int, claim: float, clock: Callable[[], float] = time.perf_counter
) -> None:
    """Runs a call and its reference by turns, and fails if the median of their ratios exceeds the claim.

    By processor time (`time.process_time`) the work of one thread is told from that of other processes.
    """
    call()
    reference()
    spent = []

    def turn() -> None:
        spent.append((seconds(call, clock), seconds(reference, clock)))

    benchmark.pedantic(turn, rounds=rounds, iterations=1)
    _judge(benchmark, statistics.median(mine / other for mine, other in spent), spent, claim)


def summed_ratio(benchmark, pairs: Sequence[tuple[Call, Call]], claim: float) -> None:
    """Runs one long work and its reference in parts that take turns, and fails if the ratio of their sums exceeds the claim."""
    spent = []

    def turns() -> None:
        for i, pair in enumerate(pairs):
            first, second = (seconds(call) for call in (pair if i % 2 else pair[::-1]))
            spent.append((first, second) if i % 2 else (second, first))

    benchmark.pedantic(turns, rounds=1, iterations=1)
    ours, reference = np.sum(spent, axis=0)
    _judge(benchmark, float(ours / reference), spent, claim)


def _judge(benchmark, ratio: float, spent: Sequence[tuple[float, float]], claim: float) -> None:
    """Records and prints a ratio beside its claim and the machine's noise, which is the spread of the reference alone."""
    ratios, references = [mine / other for mine, other in spent], [other for _, other in spent]
    low, high = np.percentile(references, [25, 75])
    noise = float((high - low) / (2 * statistics.median(references)))
    benchmark.extra_info.update(ratio=ratio, claim=claim, low=min(ratios), high=max(ratios), noise=noise)
    print(f"\n{benchmark.name}: {ratio:.2f} for {claim:g} ({min(ratios):.2f} to {max(ratios):.2f}; noise {100 * noise:.0f} %)")
    assert ratio <= claim
