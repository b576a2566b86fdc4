"""Rerun's viewer for a recording: a window, or a web page that only this machine can open and that ends with the command."""

import argparse
import importlib.util
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from models.common.errors import InputError
from models.common.printed import shell_line

COLOUR = re.compile(r"\x1b\[[0-9;]*m")
LOOPBACK = "127.0.0.1"
STARTING_TIME = 60.0  # s, longest time to wait until the web viewer answers
FAILING_TIME = 2.0  # s; if the process of the viewer still runs after this time, the viewer counts as started
ENDING_TIME = 3.0  # s, longest time to wait until the process ends after a signal; a process that runs longer is killed


def check_view(options: argparse.Namespace) -> None:
    """Checks before the simulation that `--open` or `--serve`, one of which is given, will be able to show the recording.

    Raises:
        InputError: `--no-logs` disables the recording, or no display exists for `--open`.
    """
    if options.logs is None:
        raise InputError(
            f"{'--open' if options.open else '--serve'} shows the recording, but --no-logs writes no recording; omit "
            "one of these options"
        )
    if options.open:
        check_display()


def view(options: argparse.Namespace, logs: Mapping[str, str | None]) -> None:
    """Shows a recording for `--open` or `--serve`, after flushing the output of the command.

    Raises:
        InputError: the viewer does not start.
    """
    if (recording := logs.get("rerun")) is not None:
        sys.stdout.flush()
        (open_viewer if options.open else serve_viewer)(Path(recording))


def check_display() -> None:
    """Checks that the viewer's window can be opened. Commands call this function before a long run, so that they fail early.

    Raises:
        InputError: no display is available.
    """
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            "--open needs a screen, but DISPLAY and WAYLAND_DISPLAY are not set; use --serve, and open the printed page "
            "in a browser"
        )


def open_viewer(recording: Path) -> None:
    """Opens a recording in the viewer. The window stays open when the command ends.

    Raises:
        InputError: no window opens; the message contains the reason that the viewer prints.
    """
    with tempfile.TemporaryFile() as said:  # the output goes to a file, because a pipe would close when the command ends
        command = [*_command(), "--bind", LOOPBACK, "--port", "auto", str(recording)]
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=said, start_new_session=True
            )
        except OSError as error:
            raise InputError(f"--open: {command[0]} cannot be started ({error.strerror or error}); install rerun-sdk") from error
        with suppress(subprocess.TimeoutExpired):
            if process.wait(FAILING_TIME):  # an exit code of 0 means that the user closed the window immediately
                said.seek(0)
                raise InputError(
                    f"--open: Rerun's window did not open ({_reason(said.read())}); use --serve, and open the printed "
                    f"page in a browser. The recording is {recording}"
                )


def _reason(said: bytes) -> str:
    """Returns the last line of a failed program's output, without colour codes. The last line of the output states why the
    program failed.
    """
    lines = [COLOUR.sub("", line).strip() for line in said.decode(errors="replace").splitlines()]
    return next((line.removeprefix("Error: ") for line in reversed(lines) if line), "no message")


def serve_viewer(recording: Path) -> None:
    """Serves a recording in the web viewer until Ctrl-C or SIGTERM, and then ends the viewer's process.

    The address of the web page is printed to stderr, because stdout is reserved for the result of the command.

    Raises:
        InputError: the viewer does not start, or ends by itself.
    """
    page, data = _free_ports(2)
    ports = ["--bind", LOOPBACK, "--web-viewer-port", str(page), "--port", str(data)]
    command = [*_command(), "--serve-web", *ports, str(recording)]
    source = urllib.parse.quote(f"rerun+http://{LOOPBACK}:{data}/proxy", safe="")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # SIGTERM has the same effect as Ctrl-C
    process = subprocess.Popen(  # the viewer runs in its own session, so that it does not receive Ctrl-C
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        _wait_until_up(process, f"http://{LOOPBACK}:{page}")
        print(f"serving http://{LOOPBACK}:{page}?url={source}   press Ctrl-C to stop", file=sys.stderr, flush=True)
        process.wait()
        raise InputError(f"Rerun's web viewer ended unexpectedly; start the viewer again with {shell_line(command)}")
    except KeyboardInterrupt:
        return
    finally:
        for end in (process.terminate, process.kill):
            end()
            with suppress(subprocess.TimeoutExpired):
                process.wait(ENDING_TIME)
                break


def _command() -> list[str]:
    """Returns the command that starts Rerun's viewer: the executable of the installed package, if there is one; otherwise
    `rerun`.

    The executable is started directly, not through Rerun's Python wrapper. If the command started Rerun's Python wrapper
    instead, the viewer would continue to run after the wrapper is terminated.
    """
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or not spec.submodule_search_locations:
        return ["rerun"]
    folder = Path(spec.submodule_search_locations[0])
    places = [folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun", folder / "rerun.exe", folder / "rerun"]
    return [str(next((place for place in places if place.is_file()), "rerun"))]


def _free_ports(count: int) -> list[int]:
    """Returns the numbers of free ports. Because the ports are free, several commands can serve recordings at the same time."""
    sockets = [socket.create_server((LOOPBACK, 0)) for _ in range(count)]
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def _wait_until_up(process: subprocess.Popen, address: str) -> None:
    """Waits until the viewer's page answers.

    Raises:
        InputError: the process ends, or the page does not answer within `STARTING_TIME`.
    """
    deadline = time.monotonic() + STARTING_TIME
    while time.monotonic() < deadline and process.poll() is None:
        try:
            with urllib.request.urlopen(address, timeout=5.0):
                return
        except (urllib.error.URLError, OSError):
            time.sleep(0.1)
    raise InputError(f"Rerun's web viewer does not answer at {address}; open the recording with the command rerun")
