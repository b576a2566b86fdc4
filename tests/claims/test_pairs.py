"""Every two things that a vehicle file can have, with every command: the rows of `tests.support.pairs`, run."""

import itertools
from contextlib import chdir
from functools import cache, partial
from pathlib import Path

import pytest

from models.common.errors import InputError
from tests.support.commands import main_of
from tests.support.pairs import CHEAP, FEATURES, FILES, REFUSALS, Row, arguments, files, is_file, rows

SUITE, SHARES = 7, 24  # rows in the suite; parts of all rows, each two minutes of processor time
ATTACKED = range(0, SHARES, 6)  # parts that CI runs
# A loop that is designed for a band alone hardly decays: by frequency, curves and angles count for more than the sweep allows.
# Margins extrapolate errors of readings over the timestep, and may be off for a law that answers within one.
UNJUDGED = {("band", "sweep")}
TOO_LARGE = {("pid", "margins"), ("pi", "margins"), ("full_car", "margins")}  # growth runs take gigabytes, or a minute
LOST = ("UNSTABLE", "flat tyre", "diverged")  # of loops that are not designed for what is built: nothing is claimed of their runs


@cache
def _rows(folder: Path, count: int | None) -> list[Row]:
    """All rows, those of costly commands with every level but not every pair, or the first ones of what is cheap."""
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    fits = partial(is_file, folder=folder)
    if count is not None:
        levels = {name: CHEAP.get(name, tuple(every)) for name, every in FEATURES.items()}
        return list(itertools.islice(rows(levels, fits), count))
    costly = [command for command in FEATURES["command"] if command not in CHEAP["command"]]
    cheap = rows(FEATURES | {"command": dict.fromkeys(CHEAP["command"], "")}, fits)
    return [*cheap, *rows(FEATURES | {"command": dict.fromkeys(costly, "")}, fits, of="command")]


def wrong(row: Row, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What is wrong with a run of a row; empty if nothing is."""
    if {(row["law"], row["command"]), (row["type"], row["command"])} & TOO_LARGE:
        return ""
    for name, text in files(row).items():
        (folder / name).write_text(text, encoding="utf-8")
    command, options = arguments(row)
    with chdir(folder):
        try:
            code = main_of(command)(options)
            if row["command"] == "inspect":
                code = code or main_of("sim.inspect")(sorted(map(str, Path("logs").glob("*.mcap"))))
        except InputError as error:
            fits = any(reason in str(error) for reason in REFUSALS) and len(str(error).splitlines()) == 1
            return "" if fits else f"refused: {error}"
        except Exception as error:
            return f"{type(error).__name__}: {error}"
    said = capsys.readouterr().out
    if any(lost in said for lost in LOST) or row["command"] == "margins" or (row["law"], row["command"]) in UNJUDGED:
        return ""
    if code and not (command == "synth" and (" FAILS" in said or " NOT DESIGNED" in said)):
        return f"exit code {code}: {said[-1000:]}"
    return said if "DOES NOT" in said else ""


def _all_right(some: list[Row], folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = []
    for number, row in enumerate(some):
        (folder / f"{number}").mkdir()
        if fault := wrong(row, folder / f"{number}", capsys):
            found.append(f"{ {name: level for name, level in row.items() if level != next(iter(FEATURES[name]))} }: {fault}")
    assert not found, "\n".join(found)


def test_pairs_of_features(tmp_path, capsys):
    """No command ends in a traceback, a wrong verdict or an unknown refusal, for files with any two features: a sample."""
    _all_right(_rows(tmp_path, SUITE), tmp_path, capsys)


@pytest.mark.attack
@pytest.mark.parametrize("share", ATTACKED)
def test_all_pairs_of_features(share, tmp_path, capsys, tmp_path_factory):
    """The same for a sixth of all rows, with every command. Set `ATTACKED` to all parts after a change of the vehicle file."""
    _all_right(_rows(tmp_path_factory.getbasetemp(), None)[share::SHARES], tmp_path, capsys)


def test_rows_cover_all_pairs():
    """Of a small table the rows have every pair that fits, and a pair that fits no row is left out."""
    levels = {name: ("0", "1", "2") for name in "abcd"}
    some = list(rows(levels, lambda row: (row["a"], row["b"]) != ("2", "2")))
    for one, other in itertools.combinations(levels, 2):
        met = {(row[one], row[other]) for row in some}
        assert len(met) == 9 - ({one, other} == {"a", "b"})
    assert len(some) < 20  # of 81; 9 at least
