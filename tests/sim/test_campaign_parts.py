"""`--part` and `--merge`: parts in any order, of any processes, make the folder of a whole campaign; others are refused."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from sim.campaign import manifest as campaign_manifest
from sim.campaign.__main__ import main
from sim.campaign.file import parse_campaign
from sim.campaign.manifest import read_manifest
from sim.campaign.plan import Plan
from tests.sim.test_campaign import QUICK, ROOT
from tests.support.commands import answer, prose, refused

TEXT = (
    QUICK.replace("seeds = 60", "seeds = 6").replace('["quarter_car"]', '["quarter_car", "half_car"]').replace("I_printed", "I")
)
RUNS = 2 * 2 * 2 * (6 + 1)  # vehicles, controllers, speeds, and seeds of every road


def campaign(folder, *arguments, text=TEXT):
    """Runs the campaign in a folder; its exit code."""
    (folder / "campaign.toml").write_text(text)
    return main([str(folder / "campaign.toml"), *arguments])


def assert_same_rows(*folders):
    """Asserts that the results of two folders are the same, to 1e-12 and, for differences over a peak, 1e-13."""
    one, other = (pq.read_table(folder / "results.parquet") for folder in folders)
    assert one.schema == other.schema
    for name in one.schema.names:
        for value, expected in zip(one[name].to_pylist(), other[name].to_pylist(), strict=True):
            number = isinstance(expected, float)
            assert value == (pytest.approx(expected, rel=1e-12, abs=1e-13) if number else expected), name


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """The folder of a campaign whose three parts are finished, in another order."""
    folder = tmp_path_factory.mktemp("parts")
    for part in ("3/3", "1/3", "2/3"):
        assert campaign(folder, "--part", part) == 0
    return folder


def copied(parts, folder):
    """A copy of these parts, to be changed."""
    shutil.copytree(parts, folder, dirs_exist_ok=True)
    return folder / "campaign-results" / "parts"


def test_merged_parts_are_the_whole_campaign(parts, tmp_path, capsys):
    """Three parts, run in another order, make the folder of a whole run. It verifies, and has a best law.

    Its numbers are those of runs in other batches, to 1e-12.
    """
    copied(parts, tmp_path)
    capsys.readouterr()
    merged = answer(capsys, main, str(tmp_path / "campaign.toml"), "--merge", "--best", "ride")
    (tmp_path / "campaign-results").rename(tmp_path / "merged")
    assert campaign(tmp_path) == 0
    here, there = (str(folder / "campaign.toml") for folder in (tmp_path, parts))
    plan = (tmp_path / "merged" / "plan.json").read_text().replace(json.dumps(there), json.dumps(here))
    assert plan == (tmp_path / "campaign-results" / "plan.json").read_text()
    assert_same_rows(tmp_path / "merged", tmp_path / "campaign-results")
    whole = answer(capsys, main, str(tmp_path / "campaign.toml"), "--best", "ride")
    assert merged == whole
    assert (whole["runs"], whole["new"]) == (RUNS, 0)
    assert main(["--verify", str(tmp_path / "merged"), "--runs", "2"]) == 0
    assert main([str(tmp_path / "campaign.toml"), "--merge"]) == 0  # as after a merge that was interrupted at its end


def test_shares():
    """Parts have every run once, in rows as long as batches, and about as many of each controller, road and speed."""
    text = TEXT.replace("seeds = 6", "seeds = 3000")
    plan = Plan(parse_campaign(text, Path("campaign.toml")), {})
    for of in (1, 2, 7, 40, 20_000):
        shares = [plan.share(number, of) for number in range(1, of + 1)]
        ranges = sorted(each for share in shares for each in share)
        assert [start for start, _ in ranges] == [0, *(stop for _, stop in ranges[:-1])]
        assert ranges[-1][1] == plan.count
        sizes = [sum(stop - start for start, stop in share) for share in shares]
        assert max(sizes) - min(sizes) <= 2 * 64  # vehicles, and rounds
    shares = [plan.share(number, 40) for number in range(1, 41)]
    assert min(stop - start for share in shares for start, stop in share) >= 64
    for vehicle in ("quarter_car", "half_car"):
        of = {
            controller: [
                sum(len(set(range(*each)) & set(range(block.start, block.stop))) for each in share for block in blocks)
                for share in shares
            ]
            for controller in ("passive", "I")
            if (blocks := [block for block in plan.blocks if (block.vehicle, block.controller) == (vehicle, controller)])
        }
        assert all(max(counts) - min(counts) <= 2 * 75 for counts in of.values())  # of 150


def drop(parts):
    shutil.rmtree(parts / "2-of-3")


def cut(parts):
    (parts / "1-of-3" / "results.parquet").unlink()
    shutil.rmtree(parts / "2-of-3")


def other_number(parts):
    shutil.copytree(parts / "2-of-3", parts / "2-of-20")


def other_part(parts):
    shutil.rmtree(parts / "2-of-3")
    shutil.copytree(parts / "1-of-3", parts / "2-of-3")


def other_rows(parts):
    shutil.copy(parts / "1-of-3" / "results.parquet", parts / "2-of-3")


def changed(key, value):
    """A change of the plan of part 2."""

    def change(parts):
        path = parts / "2-of-3" / "plan.json"
        plan = json.loads(path.read_text())
        path.write_text(json.dumps({**plan, key: value(plan[key])}))

    return change


def none(parts):
    shutil.rmtree(parts)


REFUSED = [
    (none, "contains no finished part of a campaign; first run each part with --part"),
    (drop, "part 2 of 3 is missing; run"),
    (cut, "part 2 of 3 is missing and part 1 of 3 is not finished; run"),
    (other_number, "the parts 1/3 and 2/20 of this campaign overlap"),
    (other_part, "2-of-3 should contain part 2/3 of the campaign, but contains 1/3"),
    (other_rows, "this file does not contain the results of this part"),
    (changed("digest", lambda digest: "0"), "2-of-3 contains the results of another campaign"),
    (changed("versions", lambda old: {**old, "roadproof": "0.1"}), "2-of-3 was started with roadproof 0.1, but"),
    (changed("controllers", lambda old: {**old, "half_car": {}}), "part 2/3 was simulated with gains that differ"),
]


@pytest.mark.parametrize(("change", "said"), REFUSED, ids=[said[:40] for _, said in REFUSED])
def test_parts_that_do_not_fit_are_refused(parts, tmp_path, change, said):
    """Parts that overlap, are missing, or are of another campaign, version or gains are refused in one line."""
    change(copied(parts, tmp_path))
    before = sorted(tmp_path.rglob("*"))
    with refused(said):
        main([str(tmp_path / "campaign.toml"), "--merge"])
    assert sorted(tmp_path.rglob("*")) == before


def test_the_campaign_file_has_changed(parts, tmp_path):
    """Parts of another campaign file are refused, whether another part runs or they are merged."""
    copied(parts, tmp_path)
    (tmp_path / "campaign.toml").write_text(TEXT.replace("[10.0, 20.0]", "[10.0, 21.0]"))
    for arguments in (["--merge"], ["--part", "1/3"]):
        with refused("contains the results of another campaign, or the files of this campaign have changed"):
            main([str(tmp_path / "campaign.toml"), *arguments])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--part", "4/3"], "--part 4/3: this is not a part of a campaign; give K/N, with K from 1 to N"),
        (["--part", "0/40"], "--part 0/40: this is not a part"),
        (["--part", "3"], "as in 3/40"),
        (["--part", "2/20"], "the parts 1/3 and 2/20 of this campaign overlap"),
        (["--part", "1/3", "--merge"], "--merge cannot be combined with --part"),
        (["--part", "1/3", "--best", "ride"], "--best cannot be combined with --part"),
        (["--merge", "--workers", "2"], "--workers cannot be combined with --merge"),
        ([], "contains parts of a campaign; merge the parts with --merge"),
    ],
)
def test_bad_options(parts, arguments, said):
    """Parts that cannot be, and options that do not go together, are refused in one line."""
    with refused(said):
        main([str(parts / "campaign.toml"), *arguments])


def test_parts_are_not_verified(parts, tmp_path):
    """`--verify` wants a whole campaign."""
    for folder, said in ((".", "contains parts of a campaign; merge"), ("parts/2-of-3", "contains only part 2/3")):
        with refused(said):
            main(["--verify", str(parts / "campaign-results" / folder)])
    copied(parts, tmp_path)
    assert main([str(tmp_path / "campaign.toml"), "--merge"]) == 0
    with refused("contains the whole campaign, not a part; omit --part"):
        main([str(tmp_path / "campaign.toml"), "--part", "1/3"])


def test_one_plan_holds_for_parts_that_start_together(parts, tmp_path):
    """Of the plans of two parts that start at once the first holds, for both."""
    plan = read_manifest(parts / "campaign-results" / "parts")
    assert plan is not None
    second = read_manifest(parts / "campaign-results" / "parts" / "1-of-3")
    assert second is not None
    assert plan.publish(tmp_path / "parts") == plan
    assert second.publish(tmp_path / "parts") == plan
    assert [path.name for path in tmp_path.iterdir()] == ["parts"]


def test_no_locks(tmp_path, monkeypatch, capsys):
    """Parts run and are merged on a file system without locks, and the finished campaign is read there."""

    text = QUICK.replace("seeds = 60", "seeds = 1")

    def fails(lock):
        raise OSError(37, "No locks available")

    monkeypatch.setattr(campaign_manifest.filelock.FileLock, "_acquire", fails)
    for arguments in (["--part", "1/2"], ["--part", "2/2"], ["--merge"], []):
        assert campaign(tmp_path, *arguments, text=text) == 0
    assert "part 2 of 2 has 4 of the 8 runs" in prose(capsys.readouterr().out)
    with refused("No locks available"):
        campaign(tmp_path, "--results", str(tmp_path / "new"))


@pytest.mark.attack
def test_killed_and_run_twice(tmp_path):
    """Parts that are killed and started again, two processes for each part, have the rows of an uninterrupted run, each once."""
    text = QUICK.replace("seeds = 60", "seeds = 200")
    (tmp_path / "campaign.toml").write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}

    def start(part):
        command = [sys.executable, "-m", "sim.campaign", "campaign.toml", "--batch", "8", "--workers", "1", "--part", part]
        return subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    killed = [start(part) for part in ("1/2", "2/2", "1/2")]
    while len(list(tmp_path.glob("campaign-results/parts/*/part-*"))) < 4 and any(one.poll() is None for one in killed):
        time.sleep(0.005)
    for one in killed:
        one.send_signal(signal.SIGKILL)
        one.communicate()
    begun = tmp_path / "campaign-results" / "parts" / "2-of-2"
    shutil.rmtree(begun, ignore_errors=True)
    begun.mkdir(parents=True)
    (begun / ".plan.0123.part.json").touch()  # killed before its plan was complete
    again = [start(part) for part in ("1/2", "2/2", "1/2", "2/2")]
    assert [(one.communicate()[1], one.returncode) for one in again] == [(b"", 0)] * 4
    assert main([str(tmp_path / "campaign.toml"), "--merge"]) == 0
    assert main([str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "whole")]) == 0
    assert_same_rows(tmp_path / "whole", tmp_path / "campaign-results")
    assert pq.read_metadata(tmp_path / "whole" / "results.parquet").num_rows == 2 * 2 * 201
