"""Little address space, or the user's own models.py beside the files: a command does its work, or says in one line why not."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from models.common import memory
from models.common.errors import InputError
from models.vehicle.vehicle import parse_vehicle
from sim.command.comparison import log_lines
from sim.recording.files import record
from sim.runs.run import sample_times
from tests.commands import environment

pytest.importorskip("resource", reason="address space is limited on POSIX alone")
ROOT = Path(__file__).parent.parent
CAMPAIGN = 'vehicles = ["quarter_car"]\ncontrollers = ["passive"]\nroads = ["bump"]\nspeeds = [10.0]\nduration = 0.1\n'
BUMP = ["sim.bump", "--controller", "I", "--duration", "0.1", "--logs", "logs"]
RUN = ["sim.campaign", "campaign.toml", "--results", "results", "--workers", "1"]
LIMITED = [  # command, MiB, exit codes that are allowed, what it leaves
    (BUMP, 300, {2}, set()),
    (BUMP, 640, {2}, set()),  # between here and 560 MiB OpenBLAS ends some runs by a fault of its own
    ([*BUMP, "--brief"], 700, {0}, {"mcap", "layout.json"}),
    (BUMP, 1024, {0}, {"mcap", "layout.json"}),
    (BUMP, 2048, {0}, {"mcap", "layout.json", "rrd"}),
    (RUN, 700, {2}, set()),
    (RUN, 1024, {0, 2}, {"json", "parquet"}),
    (RUN, 2048, {0}, {"json", "parquet"}),
    (["sim.drive", "--controller", "I", "--duration", "0.2", "--no-logs"], 700, {0, 2}, set()),
    (["synth", "--controller", "I", "--save", "saved.toml"], 700, {0, 2}, {"toml"}),
    (["sim.margins", "--controller", "I"], 700, {0, 2}, set()),
    (["sim.report", "--quick", "--out", "report.html"], 700, {0, 2}, {"html"}),
]


def limited(arguments: list[str], mebibytes: int, folder: Path) -> subprocess.CompletedProcess[str]:
    """A command in a folder, with so much address space."""
    line = ["sh", "-c", f'ulimit -v {mebibytes * 1024}; exec "$@"', "sh", sys.executable, "-m", *arguments]
    return subprocess.run(line, cwd=folder, env=environment(), capture_output=True, text=True, timeout=300)


@pytest.mark.attack
@pytest.mark.parametrize(
    ("arguments", "mebibytes", "codes", "left"), LIMITED, ids=[f"{row[0][0]} {row[1]} MiB" for row in LIMITED]
)
def test_little_address_space(arguments, mebibytes, codes, left, tmp_path):
    """With 300 MiB to 2 GiB a command ends well, or with 2 and one line that names the limit; what it leaves is whole."""
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    run = limited(arguments, mebibytes, tmp_path)
    assert run.returncode in codes, run.stderr
    files = {path.name for path in tmp_path.rglob("*") if path.is_file()} - {"campaign.toml", ".lock"}
    assert not [name for name in files if name.startswith(".")], files
    if run.returncode == 2:
        assert run.stderr.startswith("roadproof: ")
        assert run.stderr.count("\n") == 1
        assert f"the address space is limited to {mebibytes * 2**20 / 1e6:.0f} MB (ulimit -v)" in run.stderr
        assert files <= {"campaign.json"}
    else:
        kinds = {name.partition(".")[2] for name in files}
        assert kinds in (left, left - {"rrd"})  # how much Rerun's threads take differs from machine to machine
        assert run.stderr == ""
        assert ("no .rrd file, as the address space is limited" in run.stdout) == ("mcap" in kinds and "rrd" not in kinds)


THREAD = OSError("failed to spawn the encoder's thread: Resource temporarily unavailable (os error 11)")


@pytest.mark.parametrize("error", [THREAD, RuntimeError("can't start new thread"), MemoryError()])
def test_a_recording_without_room_for_rerun_says_so(error, lifting, monkeypatch, tmp_path):
    """Where Rerun finds too little of a limited address space, the MCAP file is whole, and a line names the limit; a full disk is
    no lack of memory."""

    def fails(path, *rest):
        path.write_bytes(b"a part")
        raise error

    monkeypatch.setattr("sim.recording.rerun_writer.write_rrd", fails)
    if error is THREAD:
        assert not memory.is_short(error)  # without a limit
        with pytest.raises(InputError, match="cannot write recordings"):
            record(tmp_path, "run", [lifting], {}, {})
    monkeypatch.setattr(memory, "limit", lambda: memory.AMPLE / 2)
    monkeypatch.setattr(memory, "room", lambda: memory.AMPLE / 2)
    paths = record(tmp_path, "run", [lifting], {}, {})
    assert {*paths} == {"mcap", "layout"}
    assert {path.name for path in tmp_path.iterdir()} == {"run.mcap", "run.layout.json"}
    (line,) = log_lines({kind: str(path) for kind, path in paths.items()}, brief=True)
    assert line == "  no .rrd file, as the address space is limited to 2147 MB (ulimit -v), which is too little for Rerun; " + (
        "raise the limit to have one"
    )
    assert line in log_lines({kind: str(path) for kind, path in paths.items()})
    error = OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(InputError, match="No space left"):
        record(tmp_path, "run", [lifting], {}, {})


@pytest.mark.attack
def test_files_of_the_users_own_names(tmp_path):
    """`models.py` and `synth.py` beside the user's files hinder no command; nor does `sim.py` the installed `roadproof`."""
    for name in ("models", "synth"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong file')\n")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "roadproof").write_text("from sim.__main__ import roadproof\nroadproof()\n")
    quick = ["--controller", "passive", "--duration", "0.1", "--no-logs", "--brief"]
    known = environment() | {"PYTHONPATH": str(ROOT)}
    for command in (["-m", "sim.bump", *quick], ["elsewhere/roadproof", "bump", *quick], ["-m", "synth", *quick[:2]]):
        if command[1] == "synth":
            (tmp_path / "synth.py").unlink()  # that would be what `-m` names
        run = subprocess.run([sys.executable, *command], cwd=tmp_path, env=known, capture_output=True, text=True, timeout=120)
        assert (run.returncode, run.stderr) == (0, "")
        (tmp_path / "sim.py").write_text("raise SystemExit('the wrong file')\n")


@pytest.mark.parametrize(
    ("name", "command"),
    [("models", "-m sim.bump"), ("models", "-m synth"), ("synth", "-m sim.bump"), ("models", "mine.py"), ("synth", "mine.py")],
)
def test_a_file_that_hides_a_package_is_named(name, command, tmp_path):
    """A file of the user's that is found before a package is named in one line, with the command that works there."""
    (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong file')\n")
    (tmp_path / "mine.py").write_text("import sim\n")
    known = environment() | {"PYTHONPATH": os.pathsep.join(map(str, (tmp_path, ROOT)))}
    run = subprocess.run([sys.executable, *command.split()], cwd=tmp_path, env=known, capture_output=True, text=True, timeout=60)
    line = f"{tmp_path / name}.py hides Roadproof's package '{name}'; rename it, or run commands as in: roadproof bump\n"
    if command.startswith("-m"):
        assert (run.returncode, run.stdout, run.stderr) == (2, "", f"roadproof: {line}")
    else:
        assert (run.returncode, run.stderr.splitlines(keepends=True)[-1]) == (1, f"ImportError: {line}")


def test_a_valve_too_fast_is_named():
    """A timestep that is too large for the valve of an adjustable damper is refused with the key of the valve."""
    text = (ROOT / "models" / "quarter_car.toml").read_text(encoding="utf-8")
    fast = parse_vehicle(f'{text}\n[actuators]\nkind = "damper"\nc_min = 300.0\nc_max = 3000.0\nbandwidth = 1e9\n')
    with pytest.raises(InputError, match=r"above 2.78e-09 s, because of \[actuators\] bandwidth = 1e\+09 rad/s; give a smaller"):
        sample_times(fast, 1.0, 1e-3)


@pytest.mark.attack
def test_processes_beside(tmp_path):
    """The processes that a report begins are ours, too, where the user's folder has a `sim.py`."""
    for name in ("models", "synth", "sim"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong file')\n")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "roadproof").write_text("from sim.__main__ import roadproof\nroadproof()\n")
    command = [sys.executable, "elsewhere/roadproof", "report", "--quick", "--out", "report.html"]
    known = environment() | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, cwd=tmp_path, env=known, capture_output=True, text=True, timeout=300)
    assert (run.returncode, run.stderr) == (0, "")
