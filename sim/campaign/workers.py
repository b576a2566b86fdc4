"""Execution of the batches of a campaign, on threads of this machine or on a Ray cluster."""

import itertools
import socket
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.common.threads import AHEAD, one_thread, side_by_side
from sim.campaign import HERE
from sim.campaign.batch import Rows, run_batch
from sim.campaign.plan import Plan

# number of the first run in a batch, the rows of the batch, and the time that it took [s]
BatchResult = tuple[int, Rows, float]
ANSWER = 3.0  # s, longest time to wait until the head node of a cluster answers
TOKEN = "start a cluster with ray start --head; if it uses tokens, as Ray 2.60 does by default, set RAY_AUTH_MODE=token here, too"
RETRIES = 5  # largest number of repetitions of a batch whose Ray worker has died


@one_thread()
def run_timed(plan: Plan, start: int, stop: int, stopped: Callable[[], bool] = lambda: False) -> tuple[Rows | None, float]:
    """Returns the rows that `run_batch` returns, and the time that `run_batch` took [s]."""
    began = time.monotonic()
    return run_batch(plan, start, stop, stopped), time.monotonic() - began


def local(plan: Plan, batches: Iterator[tuple[int, int]], workers: int) -> Generator[BatchResult]:
    """Runs batches on threads, and yields the result of each batch when it is complete.

    Threads run in parallel, because MuJoCo and NumPy release Python's global interpreter lock.
    """
    from models.common.children import kill_children

    def piece(batch: tuple[int, int]) -> Callable[[Callable[[], bool]], tuple[int, Rows | None, float]]:
        return lambda stopped: (batch[0], *run_timed(plan, *batch, stopped))

    with closing(side_by_side(map(piece, batches), workers, kill_children)) as done:
        for _, (start, rows, took) in done:
            if rows is not None:
                yield start, rows, took


@contextmanager
def cluster(address: str) -> Iterator[None]:
    """Connects to a Ray cluster while the context is active.

    Args:
        address: `HERE` for a temporary cluster of this machine's cores, `auto` for the cluster that this machine belongs to, or
            HOST:PORT of a cluster's head node.

    Raises:
        InputError: Ray is not installed, or no Ray cluster answers at the address.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports] - an extra
    except ImportError as error:
        raise InputError("--ray needs the package Ray; install Ray with: pip install -e '.[cluster]'") from error
    if address not in (HERE, "auto"):
        _check_address(address)
    # Workers on this machine import Roadproof from its source folder; on other machines, Roadproof must be installed.
    environment = {"env_vars": {"PYTHONPATH": str(Path(__file__).parent.parent.parent)}}
    try:
        ray.init(address=address, runtime_env=environment, log_to_driver=False, configure_logging=False)
    except Exception as error:  # Ray raises many types of errors; wrong tokens, for example, cause no ConnectionError
        said = str(error).splitlines() or [type(error).__name__]
        raise InputError(f"--ray {address}: cannot connect to a Ray cluster ({said[0]}); {TOKEN}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _check_address(address: str) -> None:
    """Checks that a server answers at an address, because Ray itself would try to connect for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not (colon and host and port.isdecimal() and 0 < int(port) < 2**16):
        raise InputError(f"--ray {address}: this is not an address; give HOST:PORT of the cluster's head node, or auto")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER).close()
    except OSError as error:
        raise InputError(
            f"--ray {address}: the address does not answer ({error.strerror or error}); give the address that ray start "
            "--head prints"
        ) from error


def on_ray(plan: Plan, batches: Iterator[tuple[int, int]]) -> Generator[BatchResult]:
    """Runs batches on the connected Ray cluster, and yields the result of each batch. If a worker process dies, the batch that
    it was simulating is repeated.
    """
    import ray  # pyright: ignore[reportMissingImports] - an extra

    remote: Any = ray.remote(num_cpus=1, max_retries=RETRIES)(run_timed)
    shared, running = ray.put(plan), {}
    try:
        while True:
            most = max(1, int(ray.cluster_resources().get("CPU", 1))) * AHEAD
            # if a node leaves the cluster, `most` may fall below the number of running batches; no batch is then added
            for start, end in itertools.islice(batches, max(0, most - len(running))):
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


@one_thread()
def run_batches(
    plan: Plan,
    batches: Iterator[tuple[int, int]],
    workers: int,
    use_ray: bool,
    write: Callable[[int, Rows, float], None],
) -> None:
    """Runs batches and passes the rows of each batch to `write`.

    Args:
        plan: runs of the campaign.
        batches: intervals (start, stop) of run numbers.
        workers: number of threads on this machine.
        use_ray: True to run on the connected Ray cluster instead of threads on this machine.
        write: function that receives the number of the first run, the rows, and the time that the batch took [s].
    """
    with closing(on_ray(plan, batches) if use_ray else local(plan, batches, workers)) as results:
        for done in results:
            write(*done)
