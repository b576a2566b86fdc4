"""Who runs the batches of a campaign: threads of this machine, or the workers of a Ray cluster. The rows are the same."""

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

from models.errors import InputError
from sim.campaign_batch import Plan, run_batch
from synth.threads import one_thread

Rows = list[dict[str, Any]]
Done = tuple[int, Rows, float]  # first run of a batch, its rows, and the time that it took [s]
AHEAD = 2  # batches in flight per worker: one runs, one waits
RETRIES = 5  # of a batch whose Ray worker dies


@one_thread()
def run_timed(plan: Plan, start: int, stop: int, stopped: Callable[[], bool] = lambda: False) -> tuple[Rows | None, float]:
    """`run_batch`, and how long it took [s]."""
    began = time.monotonic()
    return run_batch(plan, start, stop, stopped), time.monotonic() - began


def local(plan: Plan, batches: Iterator[tuple[int, int]], workers: int) -> Iterator[Done]:
    """Runs batches on threads, in the order in which they are done. MuJoCo and numpy work outside Python's lock."""
    stop = threading.Event()
    with ThreadPoolExecutor(workers) as pool:
        running: dict[Future[tuple[Rows | None, float]], int] = {}
        try:
            while True:
                for start, end in itertools.islice(batches, workers * AHEAD - len(running)):
                    running[pool.submit(run_timed, plan, start, end, stop.is_set)] = start
                if not running:
                    return
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    (rows, took), start = done.result(), running.pop(done)
                    if rows is not None:
                        yield start, rows, took
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


def on_ray(plan: Plan, batches: Iterator[tuple[int, int]], address: str | None) -> Iterator[Done]:
    """Runs batches on a Ray cluster: one that is there, or one of this machine's cores. A batch whose worker dies runs again.

    Raises:
        InputError: Ray is not installed, or there is no cluster at the address.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports] - an extra
    except ImportError as error:
        raise InputError("--ray needs Ray; install it with: pip install -e '.[cluster]'") from error
    if not ray.is_initialized():
        try:
            # Workers on this machine find the project where it is; other machines have it installed.
            environment = {"env_vars": {"PYTHONPATH": str(Path(__file__).parent.parent)}}
            ray.init(address=address, runtime_env=environment, log_to_driver=False, configure_logging=False)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise InputError(f"--ray {address or ''}: no cluster to be had ({str(error).splitlines()[0]})") from error
    remote: Any = ray.remote(num_cpus=1, max_retries=RETRIES)(run_timed)
    shared, running = ray.put(plan), {}
    try:
        while True:
            most = max(1, int(ray.cluster_resources().get("CPU", 1))) * AHEAD
            for start, end in itertools.islice(batches, most - len(running)):
                running[remote.remote(shared, start, end)] = start
            if not running:
                return
            done, _ = ray.wait(list(running), num_returns=1)
            for reference in done:
                (rows, took), start = ray.get(reference), running.pop(reference)
                yield start, rows, took
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        if address is None:
            ray.shutdown()


@one_thread()
def run_batches(
    plan: Plan,
    batches: Iterator[tuple[int, int]],
    workers: int,
    ray_address: str | None,
    use_ray: bool,
    write: Callable[[int, Rows, float], None],
) -> None:
    """Runs batches wherever they are to run and hands their rows on, one batch at a time."""
    results = on_ray(plan, batches, ray_address) if use_ray else local(plan, batches, workers)
    try:
        for done in results:
            write(*done)
    finally:
        results.close()  # pyright: ignore[reportAttributeAccessIssue]
