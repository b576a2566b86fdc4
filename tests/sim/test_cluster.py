"""A campaign on a Ray cluster of two nodes, which is joined by its address. One node is killed."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from sim.campaign.__main__ import main

ROOT = Path(__file__).parents[2]
LONGEST = 60.0  # s for anything to happen; a node takes 4 to 8 to start, the campaign 12
CAMPAIGN = """
vehicles = ["quarter_car"]
controllers = ["passive", "I_printed"]
roads = ["iso8608:class=B", "bump:height=0.02"]
speeds = [10.0]
seeds = 300
duration = 2.0
settle = 0.5
timestep = 2e-3
"""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="nodes are ended by their process group")


@contextmanager
def node(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A node of a cluster with one core, whose processes end with the block; no other cluster's do."""
    command = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--num-cpus", "1", "--disable-usage-stats"]
    command += ["--object-store-memory", "100000000", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        yield process
    finally:
        process.terminate()  # it ends what it has started
        with suppress(subprocess.TimeoutExpired):
            process.wait(LONGEST / 3)
        end(process)


def end(process: subprocess.Popen[bytes]) -> None:
    """Kills a process and all that it has started."""
    psutil = pytest.importorskip("psutil")
    with suppress(psutil.Error):
        for child in psutil.Process(process.pid).children(recursive=True):
            with suppress(psutil.Error):
                child.kill()
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(LONGEST)


def until(happened: Callable[[], bool], what: str) -> None:
    """Waits for something."""
    deadline = time.monotonic() + LONGEST
    while not happened():
        assert time.monotonic() < deadline, f"{what}, and not within {LONGEST:g} s"
        time.sleep(0.1)


def listens(port: int) -> bool:
    """Returns True if a port of this machine answers."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
        return True
    return False


def works(process: subprocess.Popen[bytes]) -> bool:
    """Returns True if a worker of a node is at a batch; Ray calls it so."""
    psutil = pytest.importorskip("psutil")
    with suppress(psutil.Error):
        return any("run_timed" in " ".join(one.cmdline()) for one in psutil.Process(process.pid).children(recursive=True))
    return False


@pytest.mark.attack
def test_two_nodes_of_which_one_dies(tmp_path, monkeypatch):
    """`--ray HOST:PORT` joins a cluster, both nodes work, one is killed at its batch, and the rows are those of this machine."""
    pytest.importorskip("ray")
    pytest.importorskip("psutil")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # else a head asks for a token
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    assert main([str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "here")]) == 0
    with ExitStack() as stack:
        short = stack.enter_context(tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True))  # sockets lie in it
        stack.enter_context(node("--head", "--port", str(port), "--include-dashboard=false", "--temp-dir", short))
        until(lambda: listens(port), "the head was to listen")
        second = stack.enter_context(node("--address", f"127.0.0.1:{port}"))
        command = [sys.executable, "-m", "sim.campaign", "campaign.toml", "--ray", f"127.0.0.1:{port}", "--batch", "16"]
        with (tmp_path / "said").open("wb") as said:
            campaign = subprocess.Popen([*command, "--results", "there"], cwd=tmp_path, stdout=said, stderr=said)
        stack.callback(end, campaign)
        until(lambda: works(second) or campaign.poll() is not None, "the second node was to work")
        assert campaign.poll() is None, (tmp_path / "said").read_text()[-500:]
        end(second)
        assert campaign.wait(LONGEST) == 0, (tmp_path / "said").read_text()[-500:]
    assert (tmp_path / "there" / "results.parquet").read_bytes() == (tmp_path / "here" / "results.parquet").read_bytes()
    assert pq.read_table(tmp_path / "there" / "results.parquet").num_rows == 2 * (300 + 1)
