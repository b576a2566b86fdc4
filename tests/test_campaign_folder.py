"""A campaign's folder: what is damaged, copied, edited or of another campaign is found, named, and no number in the results."""

import dataclasses
import errno
import hashlib
import json
import os
import shutil
import threading
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from models.common.errors import InputError
from sim.campaign import command as campaign
from sim.campaign import manifest as campaign_manifest
from sim.campaign import store as campaign_store
from sim.campaign.__main__ import main
from sim.campaign.manifest import read_manifest
from tests import test_campaign
from tests.commands import prose

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


def flip(path, at):
    content = bytearray(path.read_bytes())
    content[at % len(content)] ^= 0x10
    path.write_bytes(content)


@pytest.mark.attack
@pytest.mark.parametrize(
    "arguments", [pytest.param(("--batch", "1"), marks=pytest.mark.attack), ("--batch", "7", "--workers", "1")], ids=" ".join
)
def test_bytes_do_not_depend_on_batches(whole, tmp_path, monkeypatch, arguments):
    """The finished file is the same to the last byte, whatever its runs were batched in, also in many groups."""
    assert start(tmp_path, *arguments) == 0
    assert (tmp_path / "results" / "results.parquet").read_bytes() == whole[1]


def test_a_name_with_colons(tmp_path, monkeypatch):
    """A folder's name is a name, also where a library would take it for an address."""
    (tmp_path / "campaign.toml").write_text(test_campaign.QUICK.replace("seeds = 60", "seeds = 1"))
    monkeypatch.chdir(tmp_path)
    for name in ("s3:0:1", "plain"):
        assert main(["campaign.toml", "--results", name]) == 0
    assert (tmp_path / "s3:0:1" / "results.parquet").read_bytes() == (tmp_path / "plain" / "results.parquet").read_bytes()
    assert main(["--verify", "s3:0:1", "--runs", "1"]) == 0


def test_groups_and_joined_parts(whole, tmp_path, monkeypatch):
    """Parts are joined while it runs, and groups cut, at places that are no batch's; the rows stay the same."""
    monkeypatch.setattr(campaign_store, "JOINED", 3)
    monkeypatch.setattr(campaign_store, "GROUP", 11)
    finish, parts = campaign_store.Store.finish, list[Path]()

    def finished(store: campaign_store.Store) -> None:
        parts.extend(store.folder.glob("part-*"))
        finish(store)

    monkeypatch.setattr(campaign_store.Store, "finish", finished)
    assert start(tmp_path, "--batch", "2") == 0
    assert len(parts) <= 4 + 2 * 5 < RUNS // 2  # those of a group, and two small ones beside each at most
    file = pq.ParquetFile(tmp_path / "results" / "results.parquet")
    assert [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)] == [11, 11, 11, 11, 8]
    assert file.read().to_pylist() == pq.read_table(whole[0] / "results.parquet").to_pylist()


def cut(parts):
    parts[1].write_bytes(parts[1].read_bytes()[:-100])


def emptied(parts):
    parts[1].write_bytes(b"")


def renamed(parts):  # its runs under the numbers of others
    parts[1].rename(parts[1].with_name(parts[1].name.replace("part-000000008-000000016", "part-000000016-000000024")))


def copied(parts):
    shutil.copy(parts[1], parts[1].with_name("part-000000030-000000038-" + parts[1].name.split("-")[-1]))


def another_row(parts):
    table = pq.read_table(parts[1])
    pq.write_table(table.slice(0, 3), parts[1])


def other_runs(parts):  # rows of others under its name, with their checksum
    table = pq.read_table(parts[1])
    table = table.set_column(0, table.schema.field(0), pa.array(table["run"].to_numpy() + 1))
    sealed(parts, table)


def no_runs(parts):
    sealed(parts, pq.read_table(parts[1]).drop_columns(["run"]))


def sealed(parts, table):
    """Writes a table as the second part, with a checksum that is right."""
    path = parts[1]
    manifest = read_manifest(path.parent)
    assert manifest is not None
    pq.write_table(table, path)
    start, stop = path.name.split("-")[1:3]
    made = hashlib.sha256(f"{manifest.seal} {int(start)} {int(stop)} ".encode() + path.read_bytes()).hexdigest()[:32]
    path.rename(path.with_name(f"part-{start}-{stop}-{made}.parquet"))


def stray(parts):
    parts[1].with_name("part-notes.txt").write_text("mine")


def a_pipe(parts):
    parts[1].unlink()
    if not hasattr(os, "mkfifo"):
        pytest.skip("pipes are POSIX's")
    os.mkfifo(parts[1])


DAMAGES = [cut, renamed, copied, other_runs, no_runs, stray]
MORE = [emptied, another_row, a_pipe]


@pytest.mark.parametrize(
    "damage", [*DAMAGES, *(pytest.param(one, marks=pytest.mark.attack) for one in MORE)], ids=lambda one: one.__name__
)
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
    assert "run again" in named[0]


@pytest.mark.attack
def test_random_damage_to_parts(whole, begun, tmp_path):
    """Twenty random flips of a bit or cuts, in any file of a campaign that has begun: complete and the same, or named."""
    rng = np.random.default_rng(8)
    for trial in range(20):
        folder = tmp_path / str(trial)
        shutil.copytree(begun, folder / "results")
        files = sorted(path for path in (folder / "results").iterdir() if path.name != ".lock")
        victim = files[rng.integers(len(files))]
        size = victim.stat().st_size
        if rng.random() < 0.5:
            flip(victim, int(rng.integers(size)))
        else:
            victim.write_bytes(victim.read_bytes()[: rng.integers(size)])
        try:
            assert start(folder) == 0
        except InputError as error:
            assert "campaign.json" in str(error)  # noqa: PT017 - either is right
            assert victim.name == "campaign.json"
        else:
            assert (folder / "results" / "results.parquet").read_bytes() == whole[1]


@pytest.mark.parametrize("at", [4, 1000, -3])
def test_a_damaged_result_is_named(whole, tmp_path, capsys, at):
    """A flipped bit in the finished file is found when it is read, by the command and by --verify; nothing is removed."""
    (tmp_path / "campaign.toml").write_text(QUICK)
    shutil.copytree(whole[0], tmp_path / "results")
    flip(tmp_path / "results" / "results.parquet", at)
    damaged = (tmp_path / "results" / "results.parquet").read_bytes()
    said = "results.parquet: is not the file that the campaign wrote"
    with pytest.raises(InputError, match=said):
        main([str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "results")])
    assert main(["--verify", str(tmp_path / "results")]) == 1
    assert said in prose(capsys.readouterr().out)
    assert (tmp_path / "results" / "results.parquet").read_bytes() == damaged


@pytest.mark.parametrize("edit", ["gain", "key", "text", "not json", "empty", "list"])
def test_an_edited_manifest_is_not_driven(begun, tmp_path, edit):
    """A gain that was edited, a key that is gone, a file that is cut: one line, and nothing is driven."""
    again(begun, tmp_path)
    path = tmp_path / "results" / "campaign.json"
    content = json.loads(path.read_text())
    if edit == "gain":
        content["controllers"]["quarter_car"]["I_printed"]["gain"][0][0] = 20000.0
    elif edit == "key":
        del content["versions"]
    elif edit == "text":
        content["campaign"] += "\n"
    path.write_text({"not json": "{", "empty": "", "list": "[]"}.get(edit, json.dumps(content)))
    with pytest.raises(InputError, match="was changed since the campaign began, or is damaged") as caught:
        start(tmp_path)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "results" / "results.parquet").exists()


OLDER = {  # what to do with a manifest, and what is said
    "no seal": (lambda whole: whole.pop("seal"), "has no seal; it is of an older Roadproof, or was edited"),
    "no columns": (
        lambda whole: whole.pop("columns"),
        "is of another version of Roadproof (no columns); go on with that version",
    ),
    "more": (lambda whole: whole.update(later=1), "is of another version of Roadproof (later); go on with that version"),
    "another column": (
        lambda whole: whole["columns"].update(jolt={"type": "float"}),
        "was begun by another version of Roadproof, with other columns (jolt); go on with that version",
    ),
    "other definitions": (
        lambda whole: [column.update(definition="once") for column in whole["columns"].values()],
        "with other columns (run, vehicle, controller and ",
    ),
}


@pytest.mark.parametrize("what", OLDER)
@pytest.mark.parametrize("state", ["begun", "whole"])
def test_folders_of_other_versions(whole, begun, tmp_path, what, state):
    """A folder of an older or newer format, begun or finished, is named as that in one line, driven or verified; it is kept."""
    shutil.copytree({"whole": whole[0], "begun": begun}[state], tmp_path / "results")
    path = tmp_path / "results" / "campaign.json"
    content = json.loads(path.read_text())
    change, said = OLDER[what]
    change(content)
    if content.pop("seal", None):
        content["seal"] = campaign_manifest._sealed(content)
    path.write_text(json.dumps(content))
    before = {one.name: one.read_bytes() for one in (tmp_path / "results").iterdir()}
    (tmp_path / "campaign.toml").write_text(QUICK)
    file, folder = str(tmp_path / "campaign.toml"), str(tmp_path / "results")
    for arguments in ([file, "--results", folder], [file, "--verify", folder]):
        with pytest.raises(InputError) as caught:
            main(arguments)
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)
    assert {one.name: one.read_bytes() for one in (tmp_path / "results").iterdir()} == before


def test_parts_of_another_campaign(whole, begun, tmp_path):
    """Parts of a campaign with another gain are no parts of this one, though their names and shapes fit."""
    again(begun, tmp_path)
    manifest = read_manifest(tmp_path / "results")
    assert manifest is not None
    gains = json.loads(json.dumps(manifest.controllers))
    gains["quarter_car"]["I_printed"]["gain"] = [[20000.0, -2071.0]]
    dataclasses.replace(manifest, controllers=gains).write(tmp_path / "results")
    store_runs = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "run_batches", lambda plan, batches, *rest: store_runs.extend(batches))
        patch.setattr(campaign_store.Store, "finish", lambda self: None)
        patch.setattr(campaign, "summarise", lambda plan, store: [])
        patch.setattr(campaign, "summary_lines", lambda entries: [])
        patch.setattr(campaign, "compare", lambda plan, store: {})
        start(tmp_path)
    assert store_runs[0][0] == 0
    assert store_runs[-1][1] == RUNS


def test_verify(whole, capsys):
    """A finished folder holds: rows, inputs, and a sample of runs, driven again to the last bit; in words and in JSON."""
    assert main(["--verify", str(whole[0]), "--runs", "3", "--seed", "5"]) == 0
    out = prose(capsys.readouterr().out)
    assert f"each of {RUNS} runs has its row" in out
    assert "3 of them, drawn with seed 5" in out
    assert out.endswith("the results hold what the campaign comes to")
    assert main(["--verify", str(whole[0]), "--runs", "3", "--seed", "5", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["holds"], len(result["again"]), result["rows"], result["faults"]) == (True, 3, RUNS, [])


@pytest.mark.parametrize("forgery", ["campaign", "gains", "version", "unit", "column", "more"])
def test_verify_reads_what_a_file_says_of_itself(whole, tmp_path, capsys, forgery):
    """Another campaign's text, gain, version, unit or definition in the file, or a column more, does not hold."""
    shutil.copytree(whole[0], tmp_path / "results")
    file = tmp_path / "results" / "results.parquet"
    table, manifest = pq.read_table(file), read_manifest(tmp_path / "results")
    assert manifest is not None
    said = dict(table.schema.metadata)
    if forgery == "campaign":
        said[b"campaign"] += b" "
    elif forgery == "gains":
        said[b"controllers"] = said[b"controllers"].replace(b"10824", b"10825")
    elif forgery == "version":
        said[b"versions"] = json.dumps(json.loads(said[b"versions"]) | {"mujoco": "9.0.0"}).encode()
    elif forgery == "more":
        said[b"optimal"] = b"true"
    if forgery == "column":
        table = table.append_column("optimal", [[1.0] * RUNS])
    elif forgery == "unit":
        index = table.schema.get_field_index("sprung_acceleration_rms")
        table = table.cast(table.schema.set(index, table.schema.field(index).with_metadata({"unit": "km"})))
    pq.write_table(table.replace_schema_metadata(said), file)
    dataclasses.replace(manifest, results=hashlib.sha256(file.read_bytes()).hexdigest()).write(tmp_path / "results")
    assert main(["--verify", str(tmp_path / "results"), "--runs", "1"]) == 1
    assert capsys.readouterr().out.endswith("the results DO NOT HOLD what the campaign comes to\n")


EDITS = {  # of a manifest that gets a new seal, and what is said
    "seeds": (lambda content: content.update(campaign=QUICK.replace("seeds = 12", "seeds = 3000000")), "the campaign's text"),
    "columns": (lambda content: content.update(columns=None), "columns = None is not what a campaign writes"),
    "controllers": (lambda content: content.update(controllers=5), "controllers = 5 is not what a campaign writes"),
    "gain": (lambda content: content["controllers"].update(quarter_car={"I_printed": {}}), "is not what a campaign writes"),
    "gains": (lambda content: content["controllers"].pop("quarter_car"), "gains are not those of the campaign ('quarter_car')"),
    "runs": (lambda content: content.update(runs="many"), "runs = 'many' is not what a campaign writes"),
    "file": (lambda content: content.update(file=[]), "file = [] is not what a campaign writes"),
    "unsealed": (lambda content: content, "was changed since the campaign began, or is damaged"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_verify_finds_an_edited_manifest(whole, tmp_path, capsys, edit):
    """An entry of another type, or another campaign's text, under a seal made anew, is a fault in one line, also in JSON."""
    shutil.copytree(whole[0], tmp_path / "results")
    path = tmp_path / "results" / "campaign.json"
    content = json.loads(path.read_text())
    change, said = EDITS[edit]
    content.pop("seal")
    change(content)
    path.write_text(json.dumps({**content, "seal": "0" if edit == "unsealed" else campaign_manifest._sealed(content)}))
    assert main(["--verify", str(tmp_path / "results"), "--json"]) == 1
    (fault,) = json.loads(capsys.readouterr().out)["faults"]
    assert said in fault


def test_verify_finds_what_is_no_table(whole, tmp_path, capsys):
    """Under checksums made anew, results that are no Parquet file are a fault, in one line."""
    shutil.copytree(whole[0], tmp_path / "results")
    (tmp_path / "results" / "results.parquet").write_bytes(b"junk")
    manifest = read_manifest(tmp_path / "results")
    assert manifest is not None
    dataclasses.replace(manifest, results=hashlib.sha256(b"junk").hexdigest()).write(tmp_path / "results")
    assert main(["--verify", str(tmp_path / "results")]) == 1
    assert "cannot be read as Parquet" in capsys.readouterr().out


def test_verify_a_copied_folder(tmp_path, capsys):
    """A folder is verified by its own text of the campaign, moved or not; that the file is gone or another is said."""
    assert start(tmp_path) == 0
    arguments = ["--verify", str(tmp_path / "results"), "--runs", "1"]
    capsys.readouterr()
    for said in ("is another one by now", "is not there any more"):
        (tmp_path / "campaign.toml").write_text("speeds = []")
        if "any more" in said:
            (tmp_path / "campaign.toml").unlink()
        assert main(arguments) == 0
        assert said in prose(capsys.readouterr().out)


@pytest.mark.parametrize("forgery", ["number", "inputs", "rows", "gain", "order"])
def test_verify_finds_what_checksums_cannot(whole, tmp_path, capsys, forgery):
    """Somebody who makes every checksum anew around other numbers is found by computing them."""
    shutil.copytree(whole[0], tmp_path / "results")
    file = tmp_path / "results" / "results.parquet"
    table, manifest = pq.read_table(file), read_manifest(tmp_path / "results")
    assert manifest is not None
    rows = table.to_pylist()
    gains = json.loads(json.dumps(manifest.controllers))
    if forgery == "number":
        for row in rows:
            row["sprung_acceleration_rms"] *= 1 + 1e-15
    elif forgery == "inputs":
        rows[7]["speed"] = 30.0
    elif forgery == "rows":
        rows = rows[:-1]
    elif forgery == "order":
        rows[0], rows[1] = rows[1], rows[0]
    else:
        gains["quarter_car"]["I_printed"]["gain"] = [[20000.0, -2071.0]]
    pq.write_table(type(table).from_pylist(rows, schema=table.schema), file)
    forged = hashlib.sha256(file.read_bytes()).hexdigest()
    dataclasses.replace(manifest, results=forged, controllers=gains).write(tmp_path / "results")
    assert main(["--verify", str(tmp_path / "results"), "--runs", "4"]) == 1
    out = capsys.readouterr().out
    said = {"number": "when driven again", "inputs": "run 7: speed is 30.0", "rows": f"{RUNS - 1} rows for {RUNS} runs"}
    said |= {"gain": "is not the one that the vehicle file makes", "order": "not one a run"}
    assert said[forgery] in prose(out)
    assert out.endswith("the results DO NOT HOLD what the campaign comes to\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no campaign was named"),
        (["--verify", "{begun}"], "runs are not there yet"),
        (["--verify", "{empty}"], "is empty"),
        (["--verify", "{empty}/none"], "there is no such folder"),
        (["--verify", "{whole}", "--workers", "2"], "--workers does not go with it"),
        (["campaign.toml", "--seed", "1"], "--seed says what --verify drives again"),
        (["campaign.toml", "--workers", "0"], "from 1 to 1024"),
        (["campaign.toml", "--workers", "1000000000"], "from 1 to 1024"),
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


@pytest.mark.parametrize("damaged", [False, True])
def test_verify_changes_nothing(whole, begun, tmp_path, damaged):
    """--verify, which holds no folder, changes none: parts stay that a campaign, perhaps at work there, has to judge."""
    parts = again(begun, tmp_path)
    if damaged:
        flip(parts[0], 200)
    before = contents(tmp_path / "results")
    with pytest.raises(InputError, match=f"of {RUNS} runs are not there yet"):
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


@pytest.mark.parametrize("there", ["nothing", "an empty folder", "a file of somebody's"])
def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch, there):
    """A campaign that cannot write down what it is leaves no folder, and nothing in one that was there."""
    folder = tmp_path / "of" / "today"
    if there != "nothing":
        folder.mkdir(parents=True)
    if there.startswith("a file"):
        (folder / "mine").touch()
    before = sorted(tmp_path.rglob("*"))

    def full(*arguments, **named):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "campaign.toml").write_text(QUICK)
    monkeypatch.setattr(type(tmp_path), "write_text", full)
    with pytest.raises(InputError, match="No space left" if not there.startswith("a file") else "holds no campaign, but mine"):
        main([str(tmp_path / "campaign.toml"), "--results", str(folder)])
    assert sorted(tmp_path.rglob("*")) == sorted([*before, tmp_path / "campaign.toml"])


def test_the_disk_may_not_change_under_it(begun, tmp_path):
    """A part that is damaged after it was checked, while the campaign runs, is named; it never becomes rows."""
    parts = again(begun, tmp_path)
    real, once = campaign_store.Store._groups, threading.Event()

    def damaging(self):
        if not once.is_set():
            once.set()
            flip(parts[0], 200)
        return real(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign_store.Store, "_groups", damaging)
        with pytest.raises(InputError, match="was damaged while the campaign ran"):
            start(tmp_path)
    assert start(tmp_path) == 0
