"""Writing and reading of files: what is written is complete or as it was, and what cannot be read is one line."""

import os
import re
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from models.common.errors import InputError
from models.common.files import check_file, check_folder, made_folder, read_bytes, read_text, reading, together, whole_file
from models.vehicle.vehicle import read_vehicle
from tests.support.commands import main_of, refused

POSIX = pytest.mark.skipif(os.name == "nt", reason="modes, pipes and links of POSIX")


def write(path: Path, text: str = "new") -> None:
    with whole_file(path, "csv") as beside:
        beside.write_text(text)


def names(folder: Path) -> list[str]:
    """Returns the names of all files in a folder, hidden ones included."""
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_complete_or_as_it_was(tmp_path):
    """An error or Ctrl-C while a file is written leaves the old one and nothing beside it."""
    file = tmp_path / "out.csv"
    write(file, "old")
    for error in (KeyboardInterrupt, ZeroDivisionError):
        with pytest.raises(error), whole_file(file, "csv") as beside:  # noqa: PT012 - the block is what is interrupted
            beside.write_text("half")
            raise error
    assert file.read_text() == "old"
    write(file)
    assert file.read_text() == "new"
    assert names(tmp_path) == ["out.csv"]


@POSIX
def test_a_link_stays_a_link(tmp_path):
    """The target of a link is written, through links to links, also if it does not exist yet."""
    target = tmp_path / "target.csv"
    (tmp_path / "first").symlink_to("second")
    (tmp_path / "second").symlink_to(target)
    for text in ("one", "two"):
        write(tmp_path / "first", text)
        assert target.read_text() == text
    assert (tmp_path / "first").is_symlink()
    assert names(tmp_path) == ["first", "second", "target.csv"]


@POSIX
def test_permissions_stay(tmp_path):
    """A file keeps its permissions; a new one has those of the umask."""
    file = tmp_path / "out.csv"
    write(file)
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(file.stat().st_mode) == 0o666 & ~umask
    file.chmod(0o640)
    write(file, "again")
    assert file.read_text() == "again"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640


@POSIX
def test_a_full_disk_leaves_the_old_content(tmp_path):
    """If the disk is full the old content stays, and one line says why."""
    file = tmp_path / "out.csv"
    file.write_text("old")
    code = (
        "import resource, signal\nfrom pathlib import Path\nfrom models.common.files import whole_file\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\nresource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        f"with whole_file(Path({str(file)!r}), 'csv') as beside:\n    beside.write_text('x' * 9000)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert f"InputError: csv {file}: cannot be written (File too large); give another" in ended.stderr
    assert file.read_text() == "old"
    assert names(tmp_path) == ["out.csv"]


@POSIX
@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("folder", "is a folder"),
        ("read-only", "is read-only"),
        ("no folder", "there is no folder"),
        ("below a file", "there is no folder"),
    ],
)
def test_what_cannot_be_written_is_one_line(tmp_path, monkeypatch, kind, reason):
    """Before the work and after it, one line says why; nothing changes."""
    path = {"no folder": tmp_path / "missing" / "out.csv", "below a file": tmp_path / "file" / "out.csv"}.get(
        kind, tmp_path / "out.csv"
    )
    if kind == "folder":
        path.mkdir()
    elif kind == "read-only":
        path.write_text("old")
        path.chmod(0o444)
        monkeypatch.setattr(os, "access", lambda path, mode: False)  # for root everything is writable
    elif kind == "below a file":
        (tmp_path / "file").touch()
    before = [(each.name, each.lstat().st_mode, each.lstat().st_ino) for each in sorted(tmp_path.iterdir())]
    for act in (lambda: check_file(path, "csv"), lambda: write(path)):
        with refused(str(path), match=reason):
            act()
    assert [(each.name, each.lstat().st_mode, each.lstat().st_ino) for each in sorted(tmp_path.iterdir())] == before


@POSIX
def test_standard_output_and_pipes_are_written(tmp_path):
    """`/dev/stdout` is the command's own output, be it a pipe or a file; a named pipe is written to, and stays one."""
    code = (
        "from pathlib import Path\nfrom models.common.files import check_file, whole_file\npath = Path('/dev/stdout')\n"
        "check_file(path, 'csv')\nprint('before')\n"
        "with whole_file(path, 'csv') as b: b.write_text('content\\n')\nprint('after')\n"
    )
    piped = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert piped.stdout == "before\ncontent\nafter\n"
    with (tmp_path / "out").open("w") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True)
    assert (tmp_path / "out").read_text() == "before\ncontent\nafter\n"
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    texts: list[str] = []
    reader = threading.Thread(target=lambda: texts.append(read_text(pipe, "table")), daemon=True)
    reader.start()
    write(pipe)
    reader.join(10)
    assert texts == ["new"]
    assert pipe.is_fifo()


def test_a_folder_is_made_or_refused(tmp_path):
    """A folder is made with those above it; a file in its place is named."""
    check_folder(tmp_path / "a" / "b", "figures")
    assert names(tmp_path) == []
    with made_folder(tmp_path / "a" / "b", "figures"):
        assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match=f"figures {path}"):
            check_folder(path, "figures")


def test_text_is_read(tmp_path):
    """Text comes without a byte order mark and with Unix line ends; other encodings are refused in one line."""
    file = tmp_path / "car.toml"
    file.write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 2\n")
    assert read_text(file, "vehicle file") == "a = 1\nb = 2\n"
    assert read_bytes(file, "vehicle file").endswith(b"b = 2\n")
    for content in (b"\xff\xfe", "a = 1".encode("utf-16-le"), "Höhe".encode("latin-1")):
        file.write_bytes(content)
        with refused(str(file), match=r"not a text file in UTF-8.*; save the file as UTF-8, or give another"):
            read_text(file, "vehicle file")


@POSIX
@pytest.mark.parametrize("kind", ["is a folder", "a loop", "it is a link to a file", "there is no such file"])
def test_what_cannot_be_read_is_one_line(tmp_path, kind):
    """One line names the purpose, the path, the reason and what to do."""
    path = tmp_path / "car.toml"
    if kind == "is a folder":
        path.mkdir()
    elif kind != "there is no such file":
        path.symlink_to("car.toml" if kind == "a loop" else "nowhere")
    reason = "Too many levels of symbolic links" if kind == "a loop" else kind
    with pytest.raises(InputError, match=f"^vehicle file {path}: .*{reason}.*; give a TOML file$"):
        read_text(path, "vehicle file", "give a TOML file")


def test_errors_of_a_library_are_one_line(tmp_path):
    """Whatever a library raises as it reads a file becomes one line with the library's words; Ctrl-C stays what it is."""
    with pytest.raises(InputError, match=f"^road {tmp_path}: unknown header; give another file$"), reading(tmp_path, "road"):
        raise ValueError("unknown header")
    with pytest.raises(InputError, match=f"^road {tmp_path}: IndexError; give a CSV$"), reading(tmp_path, "road", "give a CSV"):
        raise IndexError
    with pytest.raises(KeyboardInterrupt), reading(tmp_path, "road"):
        raise KeyboardInterrupt


def test_several_files_get_their_names_together(tmp_path):
    """While one is missing none is there; an error leaves what was, and removes a folder that was made for them."""
    folder = tmp_path / "new" / "folder"
    write(tmp_path / "a.csv", "old")

    def write_both(error: bool) -> None:
        with made_folder(folder, "figures"), together():
            write(tmp_path / "a.csv")
            write(folder / "b.csv")
            assert (tmp_path / "a.csv").read_text() == "old"
            assert not (folder / "b.csv").exists()
            if error:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_both(error=True)
    assert names(tmp_path) == ["a.csv"]
    assert (tmp_path / "a.csv").read_text() == "old"
    write_both(error=False)
    assert (tmp_path / "a.csv").read_text() == (folder / "b.csv").read_text() == "new"
    assert names(folder) == ["b.csv"]
    assert names(tmp_path) == ["a.csv", "new"]


def test_a_tilde_is_the_home_folder(tmp_path, monkeypatch, capsys):
    """A path may begin with ~ in options, roads, loads and tables of vehicle files, and contain spaces."""
    home = tmp_path / "a home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(tmp_path)
    (home / "damper.csv").write_text("velocity [m/s],force [N]\n-1,-500\n0,0\n1,500\n")
    (home / "hump.csv").write_text("0,0\n1,0.01\n2,0\n")
    (home / "push.csv").write_text("time [s],heave [N]\n0,0\n1,10\n")
    text = re.sub("suspension_damping = .*", "", read_vehicle("quarter_car").text)
    (home / "my car.toml").write_text(text + '[curves]\nsuspension_damping = { file = "~/damper.csv" }\n')
    assert read_vehicle("~/my car.toml").parameters["suspension_damping"] == pytest.approx(500.0)
    drive = ["--vehicle", "~/my car.toml", "--controller", "passive", "--duration", "0.1", "--speed", "10", "--no-logs"]
    assert main_of("sim.drive")([*drive, "--road", "~/hump.csv", "--load", "~/push.csv", "--csv", "~/run 1.csv"]) == 0
    assert names(home) == ["damper.csv", "hump.csv", "my car.toml", "push.csv", "run 1.csv"]
    assert names(tmp_path) == ["a home"]
    capsys.readouterr()
