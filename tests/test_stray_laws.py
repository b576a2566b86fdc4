"""Laws in Python that leave something behind, a child, a thread, a swallowed Ctrl-C: a command gives one answer, and ends."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from models.common import interrupt
from models.common.errors import InputError
from models.laws.user_code import run_own
from sim.campaign.batch import FAILED
from sim.campaign.law_process import STRAY, answer_to
from tests.commands import attacks, environment
from tests.shared import printed
from tests.test_campaign_laws import BUMP, campaign_of, rows_of
from tests.test_python_laws import GAIN, vehicle_of

pytestmark = pytest.mark.skipif(os.name == "nt", reason="forks, and Ctrl-C as POSIX sends it")

ENOUGH = 60.0  # s that a command may take on a busy machine; three on an idle one
ONE = BUMP.replace('"linear", "mine", "many"', '"mine"').replace("count = 4", "count = 2")  # one of which is above 500 kg


def bump(path, *options: str) -> list[str]:
    """The command that drives a law for a moment."""
    return [sys.executable, "-m", "sim.bump", "--vehicle", str(path), "--controller", "mine", "--no-logs", *options]


BODIES = {
    "forks": "    if sample.time == 0.005: os.fork()\n",
    "forks, and its child raises": "    if sample.time == 0.006 and not os.fork(): raise ValueError('of the child')\n",
    "forks past Python": "    if sample.time == 0.007: ctypes.CDLL(None).fork()\n",
    "begins a thread": "    if sample.time == 0.008: threading.Thread(target=wait).start()\n",
}
EACH = [pytest.param(body, id=name, marks=pytest.mark.attack) for name, body in BODIES.items()]


def run_of(line: str) -> dict:
    """The run in what `sim.bump` prints with `--json`, but for its law's checksum."""
    return {key: value for key, value in json.loads(line)["runs"][0].items() if key != "controller"}


@pytest.mark.parametrize("body", [pytest.param("".join(BODIES.values()), id="all of it"), *EACH])
def test_a_command_has_one_end(tmp_path, body):
    """A law that forks, or begins a thread without an end, changes nothing: one answer, one exit code, and the command ends."""
    imports = "import ctypes, os, threading\ndef wait(): threading.Event().wait()\n"
    path = vehicle_of(tmp_path, imports + GAIN.replace("state):\n", f"state):\n{body}"))
    command = bump(path, "--duration", "0.02", "--json")
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=ENOUGH)
    assert (done.returncode, done.stderr) == (0, "")
    (line,) = done.stdout.splitlines()
    files = {"car.toml": path.read_text(encoding="utf-8"), "mine.py": GAIN}
    sound = printed("sim.bump", "--vehicle", "car.toml", *command[5:], files=files)
    assert sound.code == 0
    assert run_of(line) == run_of(sound.out)


# CPython 3.11 takes a jump back to the first line of a `try` for one out of it: before a loop there something has to stand.
LOOP = "            n = 0\n            while True: n += 1\n"
SWALLOWS = {
    "in a loop of its own": "    print('running')\n    while True:\n        try:\n" + LOOP,
    "in every call": "    print('running')\n    if True:\n        try: time.sleep(0.02)\n",
    "and raises another": "    print('running')\n    if True:\n        try:\n" + LOOP,
}
QUICK = "in every call"  # the others are ended after 5 s


@pytest.mark.attack
@pytest.mark.parametrize(
    "body", [pytest.param(body, id=name, marks=() if name == QUICK else pytest.mark.attack) for name, body in SWALLOWS.items()]
)
def test_ctrl_c_gets_through(tmp_path, body):
    """Ctrl-C ends a command at once, and as ever, though a law catches everything that is raised in it."""
    other = "raise ValueError" if body == SWALLOWS["and raises another"] else "pass"
    law = f"import time\ndef step(sample, state):\n{body}        except BaseException: {other}\n    return 0.0, state\n"
    command = bump(vehicle_of(tmp_path, law), "--duration", "3")
    process = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert process.stderr.readline() == "running\n"
    time.sleep(0.2)  # until it is within what catches it
    process.send_signal(signal.SIGINT)
    sent = time.monotonic()
    out, err = process.communicate(timeout=ENOUGH)
    assert time.monotonic() - sent < 10.0  # 5 s, as for any call that cannot be ended; 15 s by the limit of a call alone
    assert (process.returncode, out) == (130, "")
    assert [line for line in err.splitlines() if line != "running"] == ["roadproof: interrupted"]


@pytest.mark.parametrize("refuses", [False, True])
@pytest.mark.parametrize("swallowed", ["pass", "raise InputError('mine')", "raise SystemExit"])
def test_being_told_to_end_is_heard(tmp_path, monkeypatch, refuses, swallowed):
    """Whatever a user's code makes of the KeyboardInterrupt that it was sent, it is raised where that code ends."""
    monkeypatch.setattr(interrupt, "_raised", [])
    tell = "try:\n    interrupt._raise(2, None)\nexcept BaseException:\n    " + swallowed
    with pytest.raises(KeyboardInterrupt):
        run_own("law", tmp_path, "step", lambda: exec(tell, {"interrupt": interrupt, "InputError": InputError}), refuses)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The rows of a campaign whose law leaves nothing behind."""
    return rows_of(campaign_of(tmp_path_factory.mktemp("sound"), "    pass\n", text=ONE), "--workers", "1")


@pytest.mark.attack
@pytest.mark.parametrize(
    "arguments", [pytest.param(("--batch", "1", "--workers", "1"), marks=pytest.mark.attack), ("--workers", "2")], ids=" ".join
)
def test_a_child_answers_nothing(tmp_path, sound, arguments):
    """Rows of a campaign whose law forks are those of the law without its children, however they are batched."""
    forks = "    if 0.09 < sample.time < 0.1: __import__('os').fork()\n"
    rows = rows_of(campaign_of(tmp_path, forks, text=ONE), *arguments, results="forks")
    assert rows == sound
    assert {row["reason"] for row in rows} == {None}


DEATHS = {
    "ctypes.CDLL(None)._exit(7)": "its law ends its process (exit code 7)",
    "os._exit(7)": "law mine.py:step: step fails (SystemExit: it ends the process by os._exit(7), line 7) at 0 s",
}


@pytest.mark.attack
@pytest.mark.parametrize(("ending", "said"), [*list(DEATHS.items())[:1], *attacks(list(DEATHS.items())[1:])])
def test_what_a_law_leaves_ends_with_it(tmp_path, ending, said):
    """A child that holds the answers' pipe does not hold the campaign when its parent ends, and is ended with it."""
    children = f"open({str(tmp_path / 'children')!r}, 'a')"
    body = f"""    if mass > 500:
        import ctypes, os, time
        if not os.fork(): print(os.getpid(), file={children}, flush=True), time.sleep(1000)
        time.sleep(0.1)
        {ending}
"""
    rows = rows_of(campaign_of(tmp_path, body, text=ONE), "--workers", "1")
    for row in rows:
        ended = f"controller 'mine', {said}; mend that"
        assert row["reason"] == (f"{FAILED}{ended}" if row["parameter_sprung_mass"] > 500 else None)
    begun = [int(number) for number in (tmp_path / "children").read_text(encoding="utf-8").split()]
    assert len(begun) >= sum(row["reason"] is not None for row in rows) > 0
    for child in begun:
        for _ in range(100):  # whoever takes care of orphans has to take note
            if _gone(child):
                break
            time.sleep(0.05)
        assert _gone(child)


def _gone(process: int) -> bool:
    try:
        with open(f"/proc/{process}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"  # dead, and nobody has asked how
    except FileNotFoundError:
        return True


ROWS = [{"run": 4}, {"run": 5}]
FORGED = {
    "another batch": {"batch": [4, 5], "rows": ROWS},
    "no rows": {"batch": [4, 6], "rows": []},
    "too few": {"batch": [4, 6], "rows": ROWS[:1]},
    "rows of others": {"batch": [4, 6], "rows": [{"run": 5}, {"run": 6}]},
    "rows of nobody": {"batch": [4, 6], "rows": [{}, {}]},
    "rows that are none": {"batch": [4, 6], "rows": 3},
    "no batch": {"rows": ROWS},
    "no object": [3],
    "nothing": None,
}


def test_only_an_answer_is_one():
    """A line of another batch than was asked for, or that is no JSON, is no answer."""
    for said in ({"rows": ROWS}, {"left": "why"}, {"error": "what"}):
        answer = {"batch": [4, 6], **said}
        assert answer_to(json.dumps(answer).encode() + b"\n", 4, 6) == answer
    for line in [*(json.dumps(one).encode() for one in FORGED.values()), b"{", b"\xff", b"\n", b"[" * 100_000]:
        assert answer_to(line + b"\n", 4, 6) == {}


@pytest.mark.attack
def test_what_answers_another_question_is_begun_anew(tmp_path):
    """A law that writes into the pipe of the answers fails its own runs, with a reason; no row is of another."""
    law = """import os, stat
def step(sample, state):
    for n in range(3, 30) if sample.parameters["sprung_mass"] > 500 else ():
        try:
            if stat.S_ISFIFO(os.fstat(n).st_mode): os.write(n, b'{"batch": [0, 999], "rows": []}\\n')
        except OSError: pass
    return 0.0, state
"""
    file = campaign_of(tmp_path, text=ONE)
    (tmp_path / "mine.py").write_text(law, encoding="utf-8")
    rows = rows_of(file, "--workers", "1", "--batch", "2")
    for row in rows:
        heavy = row["parameter_sprung_mass"] > 500
        assert row["reason"] == (f"{FAILED}controller 'mine', its law {STRAY}" if heavy else None)
