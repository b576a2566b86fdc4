"""The viewer: its web page is for this machine alone, and ends as a whole; its window is the user's."""

import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from models.common.errors import InputError
from sim.bump import main
from sim.command import viewer as rerun_viewer
from tests.support.commands import refused

ENOUGH = 120.0  # s for a design, a run and a web server on a busy machine


def processes(group: int) -> list[str]:
    """Command lines of the living processes of a group."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, pgrp = stat.read_text().rpartition(")")[2].split()[:3]
            if int(pgrp) == group and state != "Z":
                found.append((stat.parent / "cmdline").read_text().replace("\0", " "))
        except (OSError, ValueError):  # it ended meanwhile
            continue
    return found


def listeners(port: int) -> list[str]:
    """Addresses at which somebody listens on a port, as the kernel writes them."""
    tables = "".join(Path(f"/proc/net/{table}").read_text() for table in ("tcp", "tcp6"))
    return re.findall(rf"([0-9A-F]+):{port:04X} [0-9A-F]+:0000 0A", tables)


@pytest.mark.attack
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.attack)])
def test_served_on_this_machine_until_interrupted(tmp_path: Path, how: signal.Signals) -> None:
    """--serve answers on the loopback address only, and Ctrl-C or SIGTERM ends it with every process it started, exit code 0."""
    command = [
        sys.executable,
        *["-m", "sim.bump", "--controller", "passive", "--duration", "0.5", "--serve", "--logs"],
        str(tmp_path),
    ]
    errors = tmp_path / "errors"
    with errors.open("w") as stderr:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    try:
        deadline = time.monotonic() + ENOUGH
        while not (found := re.search(r"serving (http://127\.0\.0\.1:(\d+)\S*127\.0\.0\.1%3A(\d+)\S*)", errors.read_text())):
            assert process.poll() is None, errors.read_text()
            assert time.monotonic() < deadline, "nothing is served"
            time.sleep(0.1)
        with urllib.request.urlopen(found[1], timeout=30) as page:
            assert b"<html" in page.read().lower()
        for port in (int(found[2]), int(found[3])):
            assert listeners(port) == ["0100007F"]  # 127.0.0.1, and no other
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        (group,) = {os.getpgid(int(child)) for child in children}
        assert group != os.getpgid(process.pid)
        assert any("rerun" in line for line in processes(group))

        process.send_signal(how)
        output, _ = process.communicate(timeout=ENOUGH)
    finally:
        process.kill()
    assert process.returncode == 0
    assert "agrees" in output
    assert processes(group) == []
    assert errors.read_text().count("\n") == 1  # no traceback


def test_a_window_needs_a_screen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """--open without a screen is refused before anything runs, and says what to do instead."""
    if not sys.platform.startswith("linux"):
        pytest.skip("elsewhere there is always one")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match=r"--open needs a screen.*--serve"):
        main(["--controller", "I", "--open", "--logs", str(tmp_path / "logs")])
    assert not (tmp_path / "logs").exists()


def test_the_window_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """--open starts the viewer on the recording, bound to this machine, in a session of its own, and does not wait for it."""
    told = tmp_path / "told"
    viewer = f"import os, sys; open({str(told)!r} + '~', 'w').write(repr((sys.argv[1:], os.getsid(0) == os.getpid())))"
    monkeypatch.setattr(
        rerun_viewer, "_command", lambda: [sys.executable, "-c", f"{viewer}; os.rename({str(told)!r} + '~', {str(told)!r})"]
    )
    rerun_viewer.open_viewer(Path("x.rrd"))
    deadline = time.monotonic() + 30
    while not told.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert told.read_text() == repr((["--bind", "127.0.0.1", "--port", "auto", "x.rrd"], True))


def test_a_window_that_does_not_open_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A viewer that ends at once, as without a graphics card, is one line with its own reason and where the recording is."""
    ending = "sys.stderr.write('listening\\n\\x1b[31mError: no\\x1b[0m adapter\\n\\n'); sys.exit(1)"
    monkeypatch.setattr(rerun_viewer, "FAILING_TIME", 60.0)
    monkeypatch.setattr(rerun_viewer, "_command", lambda: [sys.executable, "-c", f"import sys; {ending}"])
    with refused(str(tmp_path / "x.rrd"), match=r"did not open \(no adapter\)"):
        rerun_viewer.open_viewer(tmp_path / "x.rrd")


def test_a_viewer_that_does_not_come_up_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A web viewer that ends at once is an error of one line."""
    monkeypatch.setattr(rerun_viewer, "_command", lambda: [sys.executable, "-c", "raise SystemExit(1)"])
    with pytest.raises(InputError, match=r"does not answer at http://127\.0\.0\.1"):
        rerun_viewer.serve_viewer(tmp_path / "x.rrd")
