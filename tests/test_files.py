"""The two doors for files: what is written is whole and stays what it was, what is read is a plain file of a stated size."""

import errno
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from models.common import interrupt
from models.common.errors import InputError
from models.common.files import MIB, check_file, check_folder, made_folder, read_bytes, read_text, together, whole_file
from tests.commands import refused

POSIX = pytest.mark.skipif(os.name == "nt", reason="modes, pipes and links of POSIX")


def write(path: Path, text: str = "new") -> None:
    with whole_file(path, "csv") as beside:
        beside.write_text(text)


def alone(folder: Path, *names: str) -> bool:
    """Returns True if a folder holds just these."""
    return sorted(path.name for path in folder.iterdir()) == sorted(names)


def test_a_file_is_whole_or_as_it_was(tmp_path):
    """An error or an interruption while it is written leaves the old file and nothing beside it."""
    file = tmp_path / "out.csv"
    write(file, "old")
    for error in (KeyboardInterrupt, ZeroDivisionError):
        with pytest.raises(error), whole_file(file, "csv") as beside:  # noqa: PT012 - the block is what is interrupted
            beside.write_text("half")
            raise error
    assert file.read_text() == "old"
    write(file)
    assert file.read_text() == "new"
    assert alone(tmp_path, "out.csv")


@POSIX
def test_a_link_stays_a_link(tmp_path):
    """The target of a link is written, through links to links, also where it is not there yet; a hard link keeps what it had."""
    target = tmp_path / "target.csv"
    (tmp_path / "first").symlink_to("second")
    (tmp_path / "second").symlink_to(target)
    write(tmp_path / "first", "one")
    assert target.read_text() == "one"
    os.link(target, tmp_path / "other")
    write(tmp_path / "first", "two")
    assert target.read_text() == "two"
    assert (tmp_path / "other").read_text() == "one"
    assert (tmp_path / "first").is_symlink()
    assert (tmp_path / "second").is_symlink()
    assert alone(tmp_path, "first", "second", "target.csv", "other")


@POSIX
def test_mode_and_owner_stay(tmp_path):
    """A file keeps its permissions and, as far as the system lets us, its owner; a new one gets what the umask says."""
    file = tmp_path / "out.csv"
    write(file)
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(file.stat().st_mode) == 0o666 & ~umask
    file.chmod(0o640)
    if os.geteuid() == 0:
        os.chown(file, 1234, 2345)
    before = file.stat()
    write(file, "again")
    after = file.stat()
    assert file.read_text() == "again"
    assert (after.st_mode, after.st_uid, after.st_gid) == (before.st_mode, before.st_uid, before.st_gid)


@POSIX
@pytest.mark.skipif(getattr(os, "geteuid", lambda: 1)() != 0, reason="files of others are root's to make")
@pytest.mark.parametrize("sticky", [False, True])
def test_what_is_anothers_is_whole_or_as_it_was(tmp_path, monkeypatch, sticky):
    """Who may not give a file away replaces it whole all the same, opens it to no group, and says where that is forbidden."""
    file = tmp_path / "out.csv"
    file.write_text("old")
    os.chown(file, 1234, 2345)
    file.chmod(0o664)
    os.chown(tmp_path, 1234, 2345)
    tmp_path.chmod(0o1777 if sticky else 0o777)
    monkeypatch.setattr(os, "geteuid", lambda: 4321)

    def forbidden(*_) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "chown", forbidden)
    if sticky:
        for act in (lambda: check_file(file, "csv"), lambda: write(file)):
            with pytest.raises(InputError, match="another user's, and only they may replace it"):
                act()
        assert file.read_text() == "old"
    else:
        check_file(file, "csv")
        write(file)
        assert file.read_text() == "new"
        assert stat.S_IMODE(file.stat().st_mode) == 0o644
    assert alone(tmp_path, "out.csv")


@POSIX
@pytest.mark.parametrize("kind", ["hard link", "plain"])
def test_a_disk_that_is_full_leaves_the_old_content(tmp_path, kind):
    """If less is free than is written, every name of a file still holds all of what it held."""
    old, file, other = "old\n", tmp_path / "r.csv", tmp_path / "o.csv"
    file.write_text(old)
    if kind == "hard link":
        os.link(file, other)
    names = [path.name for path in tmp_path.iterdir()]
    # No write goes beyond this, as on a full disk: what is written whole beside leaves no room for a copy of any part of it.
    code = (
        "import resource, signal\nfrom pathlib import Path\nfrom models.common.files import whole_file\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"with whole_file(Path({str(file)!r}), 'csv') as beside:\n    beside.write_text('x' * 9000)\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr  # a name takes no room
    assert file.read_text() == "x" * 9000
    if kind == "hard link":
        assert other.read_text() == old
    assert alone(tmp_path, *names)


@POSIX
@pytest.mark.parametrize("kind", ["folder", "fifo", "socket", "read-only", "loop", "link to a fifo", "no folder", "below a file"])
def test_what_is_no_plain_file_is_refused_and_left(tmp_path, monkeypatch, kind):
    """Before the work and after it, in one line that says what was found; what was there is there, and as it was."""
    path, found = tmp_path / "out.csv", {"folder": "is a folder", "fifo": "is a pipe", "socket": "is a socket"}.get(kind, "")
    held = None
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "socket":
        held = socket.socket(socket.AF_UNIX)
        monkeypatch.chdir(tmp_path)  # names of sockets are short
        held.bind("out.csv")
    elif kind == "read-only":
        path.write_text("old")
        path.chmod(0o444)
        found = "is read-only"
    elif kind == "loop":
        path.symlink_to("other")
        (tmp_path / "other").symlink_to("out.csv")
        found = "loop"
    elif kind == "link to a fifo":
        os.mkfifo(tmp_path / "pipe")
        path.symlink_to("pipe")
        found = "is a pipe"
    elif kind == "no folder":
        path, found = tmp_path / "not there" / "out.csv", "there is no folder"
    else:
        (tmp_path / "file").touch()
        path, found = tmp_path / "file" / "out.csv", "there is no folder"
    before = sorted((each.name, each.lstat().st_mode, each.lstat().st_ino) for each in tmp_path.iterdir())
    for act in (lambda: check_file(path, "csv"), lambda: write(path)):
        with refused(str(path), match=found):
            act()
    assert sorted((each.name, each.lstat().st_mode, each.lstat().st_ino) for each in tmp_path.iterdir()) == before
    if held:
        held.close()


@POSIX
def test_standard_output_may_be_written(tmp_path):
    """`/dev/stdout` is the command's own output, be it a pipe or a file, and it stays what it is."""
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


def test_a_folder_is_made_or_refused(tmp_path):
    """A folder is made with those above it; a file in its place is named."""
    check_folder(tmp_path / "a" / "b", "figures")
    assert alone(tmp_path)
    with made_folder(tmp_path / "a" / "b", "figures"):
        assert (tmp_path / "a" / "b").is_dir()
    assert alone(tmp_path / "a" / "b")
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match=f"figures {path}"):
            check_folder(path, "figures")


def test_a_plain_file_is_read(tmp_path):
    """Text comes without a byte order mark and with Unix line ends, of at most the stated size."""
    file = tmp_path / "car.toml"
    file.write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 2\n")
    assert read_text(file, "vehicle file", MIB, "give one") == "a = 1\nb = 2\n"
    assert read_bytes(file, "vehicle file", 16, "give one").endswith(b"b = 2\n")
    with pytest.raises(InputError, match="too large"):
        read_bytes(file, "vehicle file", 15, "give one")
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match=r"UTF-8 .*at byte 0\); save it as UTF-8, or give one"):
        read_text(file, "vehicle file", MIB, "give one")


@POSIX
@pytest.mark.parametrize(
    ("kind", "found"),
    [
        ("folder", "is a folder"),
        ("fifo", "is a pipe"),
        ("zero", "is a device"),
        ("sparse", "too large"),
        ("memory", "cannot be read"),
        ("loop", "loop of links"),
        ("dangling", "link to nothing"),
        ("missing", "no such file"),
    ],
)
def test_nothing_else_is_read_or_waited_for(tmp_path, kind, found):
    """One line at once, whatever a name leads to: no memory is filled and no pipe is waited for."""
    path = tmp_path / "car.toml"
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "zero":
        path = Path("/dev/zero")
    elif kind == "sparse":
        with path.open("wb") as file:
            file.truncate(20 * 1024 * MIB)
    elif kind == "memory":
        path = Path("/proc/self/mem")
        if not path.exists():
            pytest.skip("only Linux shows a process's memory as a file")
    elif kind == "loop":
        path.symlink_to("car.toml")
    elif kind == "dangling":
        path.symlink_to("nowhere")
    answers: list[str] = []

    def ask() -> None:
        with pytest.raises(InputError) as caught:
            read_text(path, "vehicle file", MIB, "give a TOML file")
        answers.append(str(caught.value))

    asked = threading.Thread(target=ask, daemon=True)
    asked.start()
    asked.join(5.0)
    assert len(answers) == 1
    assert found in answers[0]
    assert answers[0].startswith(f"vehicle file {path}: ")
    assert answers[0].endswith("give a TOML file")


def test_several_files_get_their_names_together_or_not_at_all(tmp_path):
    """While one is missing none is there; an error leaves what was, and takes back a folder that was made for them."""
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
    assert alone(tmp_path, "a.csv")
    assert (tmp_path / "a.csv").read_text() == "old"
    write_both(error=False)
    assert (tmp_path / "a.csv").read_text() == (folder / "b.csv").read_text() == "new"
    assert alone(folder, "b.csv")
    assert alone(tmp_path, "a.csv", "new")


@pytest.mark.parametrize("links", [True, False])
def test_where_one_file_cannot_get_its_name_none_keeps_it(tmp_path, monkeypatch, links):
    """The last of four cannot: what was there before is there again, what was not is gone; with hard links, and without."""
    write(tmp_path / "a.csv", "old")
    write(tmp_path / "d.csv", "old")
    rename = Path.replace

    def replace(beside: Path, target: Path) -> Path:
        if target.name == "d.csv":
            assert {name: (tmp_path / f"{name}.csv").read_text() for name in "abcd"} == dict.fromkeys("abc", "new") | {"d": "old"}
            raise PermissionError(errno.EPERM, "not this one")
        return rename(beside, target)

    def hardlink_to(link: Path, target: Path) -> None:
        raise PermissionError(errno.EPERM, "no links here")

    monkeypatch.setattr(Path, "replace", replace)
    if not links:
        monkeypatch.setattr(Path, "hardlink_to", hardlink_to)

    def write_all() -> None:
        with together():
            for name in "abcd":
                write(tmp_path / f"{name}.csv")

    with pytest.raises(InputError, match=r"^the output files cannot be renamed \(not this one\); mend that and try again$"):
        write_all()
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "d.csv").read_text() == "old"
    assert alone(tmp_path, "a.csv", "d.csv")


@POSIX
def test_what_is_being_finished_is_not_interrupted():
    """One Ctrl-C comes too late for it, a second one is heeded, and afterwards it is as before."""
    before = signal.getsignal(signal.SIGINT)
    with interrupt.uninterrupted():
        signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interrupt.uninterrupted():  # noqa: PT012 - the block is what is interrupted
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
