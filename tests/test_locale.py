"""Names in other scripts work in every locale, and what a terminal lacks is escaped."""

import os
import shutil
import subprocess
import sys

import pytest

from models.kinds.kind import HERE

CONTROLLER = '\n[controllers."{}"]\nmeasured = ["sprung_velocity"]\ngain = [[-8970.3]]\n'
ASCII = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}  # what C was before Python 3.7

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there names are UTF-16, whatever the locale")


@pytest.fixture(scope="session")
def latin(tmp_path_factory):
    """A locale of ISO 8859-1."""
    folder = tmp_path_factory.mktemp("locale")
    if shutil.which("localedef") is None:
        pytest.skip("localedef is not installed")
    subprocess.run(
        ["localedef", "-f", "ISO-8859-1", "-i", "en_US", str(folder / "en_US.ISO-8859-1")], capture_output=True, timeout=60
    )
    if not (folder / "en_US.ISO-8859-1").exists():
        pytest.skip("localedef has no sources here")
    return {"LOCPATH": str(folder), "LC_ALL": "en_US.ISO-8859-1"}


@pytest.fixture
def locale(request):
    """The environment of a locale that is not UTF-8."""
    if request.param == "latin":
        return request.getfixturevalue("latin")
    return ASCII if request.param == "ASCII" else {"LC_ALL": "C"}


def some_locales(*later: str):
    """All of them; those that come with the attacks are tested with the suite in the other test of this kind."""
    names = ("ASCII", "latin", "C")
    marked = [pytest.param(name, marks=pytest.mark.attack) if name in later else name for name in names]
    return pytest.mark.parametrize("locale", marked, indirect=True)


def run(folder, locale, *arguments) -> subprocess.CompletedProcess[bytes]:
    """A command in a locale, in a folder; what it prints as bytes."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("LC_", "LANG", "PYTHONUTF8", "PYTHONIO"))}
    environment = kept | locale | {"PYTHONPATH": str(HERE.parent), "OMP_NUM_THREADS": "1"}
    ran = subprocess.run([sys.executable, "-m", *arguments], cwd=folder, env=environment, capture_output=True, timeout=120)
    assert b"Traceback" not in ran.stderr, ran.stderr.decode()
    return ran


def vehicle(path, name: str) -> None:
    """A vehicle file with a controller of that name, and no other."""
    text = (HERE / "quarter_car.toml").read_text(encoding="utf-8").partition("[controllers.")[0]
    path.write_text(text + CONTROLLER.format(name), encoding="utf-8")


@some_locales("latin", "C")
def test_cyrillic(tmp_path, locale):
    """A Cyrillic vehicle file and controller are found, printed, recorded under their names; an unknown one is named as it is."""
    vehicle(tmp_path / "Ы.toml", "Жук")
    options = ("--vehicle", "Ы.toml", "--controller", "Жук", "--duration", "0.1", "--logs", "журнал")
    ran = run(tmp_path, locale, "sim.bump", *options)
    assert ran.returncode == 0, ran.stderr.decode()
    assert "Жук: norm" in ran.stdout.decode()
    assert [path.name for path in (tmp_path / "журнал").glob("*Жук*.mcap")]
    ran = run(tmp_path, locale, "synth", "--vehicle", "Ы.toml", "--controller", "Щ")
    assert ran.returncode == 2
    assert ran.stderr.decode().startswith("roadproof: unknown controller 'Щ'")


@pytest.mark.attack
@some_locales("ASCII", "C")
def test_what_the_terminal_lacks(tmp_path, locale):
    """If only ASCII was typed, what the terminal's encoding lacks is escaped, and files have their names all the same."""
    vehicle(tmp_path / "car.toml", "Жук")
    ran = run(tmp_path, locale, "sim.bump", "--vehicle", "car.toml", "--controller", "all", "--duration", "0.1", "--logs", "logs")
    assert ran.returncode == 0, ran.stderr.decode()
    utf8 = locale == {"LC_ALL": "C"}  # coerced by Python itself
    assert ("Жук: norm".encode() if utf8 else rb"\u0416\u0443\u043a: norm") in ran.stdout
    assert [path.name for path in (tmp_path / "logs").glob("*.mcap")]


@pytest.mark.attack
def test_the_locales_own(tmp_path, latin):
    """A name typed in the locale's own encoding is that name; a file that cannot be named as it should is said in one line."""
    vehicle(tmp_path / "car.toml", "é")
    ran = run(tmp_path, latin, "synth", "--vehicle", "car.toml", "--controller", b"\xe9")
    assert ran.returncode == 0, ran.stderr.decode()
    assert b"\n\xe9 " in ran.stdout
    vehicle(tmp_path / "car.toml", "Ж")
    ran = run(tmp_path, latin, "sim.bump", "--vehicle", "car.toml", "--controller", "all", "--duration", "0.1", "--logs", b"\xe9")
    assert ran.returncode == 2
    assert ran.stderr.count(b"\n") == 1
    assert b"cannot be written in this locale's encoding" in ran.stderr
