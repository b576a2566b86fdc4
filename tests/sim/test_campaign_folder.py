"""A campaign's folder: what is damaged, copied, edited or of another campaign is found, named, and no number in the results."""

import dataclasses
import errno
import json
import os
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from models.common.errors import InputError
from sim.campaign import store as campaign_store
from sim.campaign.__main__ import main
from sim.campaign.manifest import read_manifest
from tests.sim import test_campaign
from tests.support.commands import answer, prose, refused

QUICK = test_campaign.QUICK.replace("seeds = 60", "seeds = 12")
RUNS = 2 * 2 * (12 + 1)


def start(folder, *arguments):
    """Runs the campaign in a folder; its exit code."""
    (folder / "campaign.toml").write_text(QUICK)
    return main([str(folder / "campaign.toml"), "--results", str(folder / "results"), *arguments])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished campaign's folder, and its bytes."""
    folder = tmp_path_factory.mktemp("whole")
    assert start(folder) == 0
    return folder / "results", (folder / "results" / "results.parquet").read_bytes()


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """A campaign's folder with parts and no end."""
    folder = tmp_path_factory.mktemp("begun")

    class EndError(Exception):
        pass

    def ends(self):
        raise EndError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign_store.Store, "finish", ends)
        with pytest.raises(EndError):
            start(folder, "--batch", "8")
    assert len(list((folder / "results").glob("part-*"))) >= RUNS // 8
    return folder / "results"


def again(begun, folder):
    """A copy of the folder with parts, to be damaged."""
    shutil.copytree(begun, folder / "results")
    return sorted((folder / "results").glob("part-*"))


@pytest.mark.attack
def test_bytes_do_not_depend_on_batches(whole, tmp_path):
    """The finished file is the same to the last byte, whatever its runs were batched in."""
    assert start(tmp_path, "--batch", "7", "--workers", "1") == 0
    assert (tmp_path / "results" / "results.parquet").read_bytes() == whole[1]


def cut(parts):
    parts[1].write_bytes(parts[1].read_bytes()[:-100])


def renamed(parts):  # its runs under the numbers of others
    parts[1].rename(parts[1].with_name("part-000000016-000000024.parquet"))


@pytest.mark.parametrize("damage", [cut, renamed], ids=lambda one: one.__name__)
def test_a_bad_part_is_run_again_and_said(whole, begun, tmp_path, capsys, damage):
    """Whatever happened to a part, the finished file is the same to the last byte, and what was found is named."""
    damage(again(begun, tmp_path))
    capsys.readouterr()
    assert start(tmp_path, "--json") == 0
    printed = capsys.readouterr()
    assert (tmp_path / "results" / "results.parquet").read_bytes() == whole[1]
    named = json.loads(printed.out)["damaged"]
    assert len(named) == 1
    assert printed.err == f"roadproof: {named[0]}\n"
    assert "simulated again" in named[0]


def test_threads_of_arrow_hold_nothing_of_python(whole, monkeypatch):
    """A thread that releases an object of Python while the interpreter ends aborts the process, after the table is printed."""
    sources, ParquetFile = [], pq.ParquetFile
    monkeypatch.setattr(pq, "ParquetFile", lambda source: sources.append(source) or ParquetFile(source))
    table = campaign_store._read(whole[0] / "results.parquet", ["run"])
    assert len(table) > 0
    assert [type(source) for source in sources] == [pa.OSFile]


def test_verify(whole, capsys):
    """A finished folder holds: rows, inputs, and a sample of runs, driven again with the same numbers; in words and in JSON."""
    assert main(["--verify", str(whole[0]), "--runs", "3", "--seed", "5"]) == 0
    out = prose(capsys.readouterr().out)
    assert f"each of the {RUNS} runs has one row" in out
    assert "3 runs, chosen with seed 5" in out
    assert out.endswith("the results agree with the campaign")
    result = answer(capsys, main, "--verify", str(whole[0]), "--runs", "3", "--seed", "5")
    assert (result["holds"], len(result["again"]), result["rows"], result["faults"]) == (True, 3, RUNS, [])


def test_verify_a_copied_folder(tmp_path, monkeypatch, capsys):
    """A folder is verified by its own text of the campaign, moved or not; that the file is gone or another is said.

    Its name is a name, also where a library would take it for an address.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "campaign.toml").write_text(QUICK)
    assert main(["campaign.toml", "--results", "s3:0:1"]) == 0
    arguments = ["--verify", "s3:0:1", "--runs", "1"]
    capsys.readouterr()
    for said in ("has changed", "no longer exists"):
        (tmp_path / "campaign.toml").write_text("speeds = []")
        if "longer" in said:
            (tmp_path / "campaign.toml").unlink()
        assert main(arguments) == 0
        assert said in prose(capsys.readouterr().out)


@pytest.mark.parametrize("forgery", ["number", "inputs", "rows", "gain", "no table"])
def test_verify_finds_other_numbers(whole, tmp_path, capsys, forgery):
    """Other numbers, inputs, rows or gains are found by running a sample again, and so is what is not a Parquet file."""
    shutil.copytree(whole[0], tmp_path / "results")
    file = tmp_path / "results" / "results.parquet"
    table, manifest = pq.read_table(file), read_manifest(tmp_path / "results")
    assert manifest is not None
    rows = table.to_pylist()
    gains = json.loads(json.dumps(manifest.controllers))
    if forgery == "number":
        for row in rows:
            row["sprung_acceleration_rms"] *= 1 + 1e-8
    elif forgery == "inputs":
        rows[7]["speed"] = 30.0
    elif forgery == "rows":
        rows = rows[:-1]
    elif forgery == "gain":
        gains["quarter_car"]["I_printed"]["gain"] = [[20000.0, -2071.0]]
    pq.write_table(type(table).from_pylist(rows, schema=table.schema), file)
    if forgery == "no table":
        file.write_bytes(b"junk")
    dataclasses.replace(manifest, controllers=gains).write(tmp_path / "results")
    assert main(["--verify", str(tmp_path / "results"), "--runs", "4"]) == 1
    out = capsys.readouterr().out
    said = {"number": "in the repeated run", "inputs": "run 7: speed is 30.0", "rows": f"{RUNS - 1} rows for {RUNS} runs"}
    said |= {"gain": "the gains in the results differ from the gains in plan.json", "no table": "results.parquet: "}
    assert said[forgery] in prose(out)
    assert out.endswith("the results DO NOT AGREE with the campaign\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "the campaign file is missing"),
        (["--verify", "{begun}"], "runs of the campaign are not finished"),
        (["--verify", "{empty}"], "this folder contains no campaign"),
        (["--verify", "{whole}", "--workers", "2"], "--workers cannot be combined with --verify"),
        (["campaign.toml", "--seed", "1"], "--seed needs --verify"),
        (["campaign.toml", "--workers", "0"], "from 1 to 1024"),
        (["campaign.toml", "--batch", "0"], "from 1 to 256"),
        (["campaign.toml", "--results", ""], "--results: is empty"),
    ],
)
def test_bad_options(whole, begun, tmp_path, arguments, said):
    """Options that do not go together, or are no numbers that can be: one line."""
    places = {"begun": begun, "whole": whole[0], "empty": tmp_path}
    with pytest.raises(InputError, match=said):
        main([argument.format(**places) for argument in arguments])


def contents(folder):
    """Every file of a folder with its bytes."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_verify_changes_nothing(whole, begun, tmp_path):
    """--verify, which holds no folder, changes none: parts stay that a campaign, perhaps at work there, has to judge."""
    cut(again(begun, tmp_path))
    before = contents(tmp_path / "results")
    with pytest.raises(InputError, match=f"of {RUNS} runs of the campaign are not finished"):
        main(["--verify", str(tmp_path / "results"), str(begun.parent / "campaign.toml")])
    assert contents(tmp_path / "results") == before
    for path in whole[0].iterdir():  # a finished folder with parts that its campaign is about to remove
        if path.name != ".lock":
            shutil.copy(path, tmp_path / "results" / path.name)
    before = contents(tmp_path / "results")
    assert main(["--verify", str(tmp_path / "results"), str(whole[0].parent / "campaign.toml"), "--runs", "1"]) == 0
    assert contents(tmp_path / "results") == before
    assert start(tmp_path) == 0
    assert not list((tmp_path / "results").glob("part-*"))


@pytest.mark.parametrize("there", [False, True])
def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch, there):
    """A campaign that cannot write down what it is leaves no folder, and nothing in one that was there."""
    folder = tmp_path / "of" / "today"
    if there:
        folder.mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))

    def full(*arguments, **named):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "campaign.toml").write_text(QUICK)
    monkeypatch.setattr(type(tmp_path), "write_text", full)
    with pytest.raises(InputError, match="No space left"):
        main([str(tmp_path / "campaign.toml"), "--results", str(folder)])
    assert sorted(tmp_path.rglob("*")) == sorted([*before, tmp_path / "campaign.toml"])


def earlier(folder: Path) -> None:
    """Turns a folder into one of version 0.1, whose plan has a seal and a checksum."""
    path = folder / "plan.json"
    content = json.loads(path.read_text()) | {"seal": "0", "results": "0"}
    path.unlink()
    (folder / "campaign.json").write_text(json.dumps(content))


def test_folders_of_an_earlier_version(whole, begun, tmp_path, capsys):
    """A finished folder of version 0.1 is read and verified; an unfinished one is refused in one line."""
    for name, folder in (("whole", whole[0]), ("begun", begun)):
        shutil.copytree(folder, tmp_path / name)
        earlier(tmp_path / name)
    (tmp_path / "campaign.toml").write_text(QUICK)
    assert answer(capsys, main, str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "whole"))["new"] == 0
    assert main(["--verify", str(tmp_path / "whole"), "--runs", "1"]) == 0
    with refused(match="was started by Roadproof 0.1; finish it with Roadproof 0.1"):
        main([str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "begun")])


@pytest.mark.parametrize("text", ["{", "[]", '{"digest": "0"}'])
def test_a_plan_that_cannot_be_read(begun, tmp_path, text):
    """A plan that is cut or lacks entries is refused in one line."""
    again(begun, tmp_path)
    (tmp_path / "results" / "plan.json").write_text(text)
    with refused(match="^campaign plan .*plan.json: "):
        start(tmp_path)
