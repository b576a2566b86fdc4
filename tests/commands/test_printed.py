"""The commands' output fits a terminal, whatever the vehicle, and ends with the answer."""

import functools
import random
import re
import shlex
from pathlib import Path

import pytest

from models.common.printed import DETAIL_LINES, LINES, WIDTH, Whole, command, fit_lines, percent, some_sentences, table, wrap_text
from models.vehicle.vehicle import read_vehicle
from sim.__main__ import COMMANDS, VERBS
from sim.inspect.log import read_log
from sim.inspect.proof import prove
from tests.commands.golden import CASES, golden
from tests.support.commands import attacks, in_the_suite, main_of, prose
from tests.support.pages import page
from tests.support.shared import printed

ROOT = Path(__file__).parents[2]
FIRST = {  # how the first sentence below the title begins, of a command whose verdicts are there
    "sim.sweep": r"For .*, every frequency response in MuJoCo is within [\de.-]+ of the exact response of the sampled loop\."
    r"|\w+ (DOES NOT AGREE|left the linear regime): "
}
LONG = "a_controller_whose_name_is_as_long_as_a_name_may_be_60_signs"
BUILT = "\n[limits]\nsuspension_stroke = 0.08\nstop_stiffness = 1e5\nactuator_force = 2e3\nactuator_bandwidth = 300.0\n"
BUILT += "[implementation]\nsample_period = 4e-3\nnoise = { sprung_velocity = 1e-3 }\n"
CAMPAIGN = """
vehicles = ["full_car"]
controllers = ["passive", "I"]
roads = ["bump", "iso8608:class=C"]
speeds = [10.0]
duration = 0.4
settle = 0.2
timestep = 2e-3
"""
ALL = "--controller all --timestep 4e-3 --duration 0.2"
SCREEN = {  # command lines, with the vehicles that the suite asks it of, and those that the attacks do
    "synth": "quarter_car_semi_active built / quarter_car_accelerometer quarter_car_goals half_car full_car",
    f"sim.bump {ALL} --no-logs": "half_car / full_car",
    f"sim.bump {ALL} --logs logs": "/ quarter_car quarter_car_accelerometer quarter_car_semi_active half_car built",
    "sim.bump --controller I --height 1.5 --duration 1 --timestep 2e-3 --no-logs": "built /",
    f"sim.drive {ALL} --class E --no-logs": "built / full_car",
    f"sim.drive {ALL} --class E --logs logs": "/ quarter_car quarter_car_goals quarter_car_semi_active half_car",
    "synth --rates 50": "/ quarter_car",
    "synth --fragility": "/ quarter_car",
    "synth --refine": "quarter_car_semi_active / quarter_car quarter_car_goals",
    "synth --prove": "quarter_car / quarter_car_accelerometer",
    "synth --cross-check": "quarter_car / quarter_car_semi_active half_car",
    "synth --front ride:travel --picture front.svg --csv front.csv": "/ quarter_car",
    "synth --check FILE": "quarter_car / quarter_car_accelerometer quarter_car_goals quarter_car_semi_active",
    "sim.sweep --timestep 4e-3": "/ quarter_car quarter_car_semi_active half_car",
    "sim.sweep --controller I --timestep 4e-3 --logs logs": "/ built",
    "sim.margins --controller CONTROLLER --timestep 4e-3": "/ quarter_car half_car built",
    "sim.envelope --controller CONTROLLER --vary height:0.02:0.4:2 --vary speed:5:20:2 --timestep 4e-3": "full_car built /",
    "sim.report --quick --timestep 4e-3": "/ half_car",
}
ONE = {"quarter_car_accelerometer": "accelerometer", "quarter_car_goals": "comfort"}  # of others it is I
RUN = r"agrees|DOES NOT AGREE|outside the linear regime"
ANSWERS = {  # how the last line, or the sentence that is the last, begins
    "synth": r"every claim holds|not every claim holds",
    "sim.bump": RUN,
    "sim.drive": RUN,
    "sim.margins": RUN,
    "sim.envelope": RUN,
    "sim.report": "MuJoCo agrees, and|no check fails|something FAILS",
    "sim.inspect": r"(the log still proves|the log DOES NOT PROVE|12 of 12 logs still prove)",
}


def too_wide(text: str) -> list[str]:
    """Lines that do not fit and could: not what cannot be broken, which is alone on its line, or after the program to run."""
    return [line for line in text.splitlines() if len(line) > WIDTH and len(line.removeprefix("  rerun ").split()) > 1]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A vehicle file with limits, an implementation, a long controller's name and an unstable loop."""
    text = read_vehicle("quarter_car").text + f'\n[controllers.{LONG}]\nmeasured = ["sprung_velocity"]\ngain = [[-8970.3]]\n'
    text += '[controllers.unstable]\nmeasured = ["sprung_velocity"]\ngain = [[9e4]]\n'
    path = tmp_path_factory.mktemp("cars") / "built.toml"
    path.write_text(text + BUILT)
    return str(path)


@pytest.mark.parametrize(
    ("car", "line"),
    [
        case
        for line, (some, _, more) in ((line, cars.partition("/")) for line, cars in SCREEN.items())
        for case in (*((car, line) for car in some.split()), *attacks([(car, line) for car in more.split()]))
    ],
)
def test_the_answer_fits_a_screen(car, line, built, tmp_path, monkeypatch, capsys):
    """Without `-v` every command answers within 24 lines of 80 columns, and its last words are the verdict on each controller.

    The verdicts of a sweep are the first words below its title and its vehicle file, and name each controller that it ran.
    For a file of long names, limits and an unstable loop there may be more lines, and two more for eleven controllers.
    """
    monkeypatch.chdir(tmp_path)
    line = line.replace("CONTROLLER", ONE.get(car, "I")).replace("FILE", str(ROOT / "models" / f"{car}.toml"))
    monkeypatch.setattr("synth.command.trade_off.DESIGNS", 12)  # a front of a few designs has the same lines
    name, *arguments = shlex.split(line)
    vehicle = built if car == "built" else car
    main_of(name)([*arguments, *([] if "--check" in arguments else ["--vehicle", vehicle])])
    out = capsys.readouterr().out
    assert len(out.splitlines()) <= LINES + 2 * (car == "quarter_car_semi_active" and "all" in arguments) or car == "built"
    if name == "sim.report":
        assert out.startswith(f"report\n  report-{car}.html\n")
    last = check_answer(name, out)
    if "all" in arguments:
        names = read_vehicle(vehicle).controller_names
        assert {*names} <= {*last.replace(",", " ").replace(":", " ").split()}


def check_answer(name: str, out: str) -> str:
    """Checks that a command's text fits and has its verdict where it belongs; returns its last sentences."""
    assert too_wide(out) == []
    if name in FIRST:
        answer = prose(out.split("\n", 2)[2])
        assert re.match(FIRST[name], answer)
        verdicts, _, rest = answer.partition("Responses were measured")
        swept = re.findall(r"^  (\w+) +[\d.]+e[+-]\d+ +(?:[\d.]+e[+-]\d+|-)$", out, re.M)  # the rows of the first table
        assert swept
        assert rest
        assert {*swept} <= {*re.findall(r"\w+", verdicts)}
        return answer
    last = prose(out[out.rindex("\n\n") :])
    assert re.search(rf"(^|\s)({ANSWERS[name]})", last)
    return last


@pytest.mark.parametrize("name", [name for name in CASES if name in {*FIRST, *ANSWERS}])
def test_golden_runs(name):
    """The text of a golden run fits a screen, and its verdict is that of its JSON."""
    run, text = golden(name, "plain"), golden(name, "plain", "")
    assert (run.code, run.err) == (text.code, text.err) == (0, "")
    assert len(text.out.splitlines()) <= LINES
    last = check_answer(name, text.out)
    for one in run.json["compared"]["controllers"] if name in ("sim.bump", "sim.drive") else []:
        assert one["controller"] == "passive" or one["controller"] in last
        assert f"{one['ride']:.3g}" in text.out


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("synth", ()),
        ("sim.bump", ("plain",)),  # over a high bump, with a log
        ("sim.drive", ("--controller", "I", "--class", "D", "--duration", "4", "--timestep", "5e-3", "--no-logs")),  # lifts off
        ("sim.sweep", ("plain",)),
        ("sim.margins", ("plain",)),
        ("sim.inspect", ("plain",)),
        *attacks([("sim.bump", ("--controller", "I")), ("sim.drive", ("--controller", "I")), ("sim.identify", ("plain",))]),
    ],
)
def test_a_screen_of_details(name, options):
    """With -v one controller of the quarter-car takes at most 40 lines of 80 columns, and the answer comes before the details.

    Gains have units and signals, and a small margin is marked as a warning.
    """
    run = printed(name, *options, "-v") if options[:1] not in ((), ("plain",)) else golden(name, "plain", "-v")
    assert (run.code, run.err) == (0, "")
    assert too_wide(run.out) == []
    assert len(run.out.splitlines()) <= DETAIL_LINES - 3 * ("--no-logs" in options)  # the log's files and a line before them
    if name in ("sim.bump", "sim.drive"):
        above, _, details = run.out.partition("\ncontroller I: measures suspension_deflection, sprung_velocity\n")
        assert re.search(r"^  I +[\d.]+ +[-+]\d+ ", above, re.M)
        assert details.startswith("  norm 7.843188 at 10.127 Hz, bound 7.871486\n  WARNING: small gain margin 1.21 (1.66 dB), ")
        assert "\n  gain: 10825.2 N/m suspension_deflection, -2069.5 N s/m sprung_velocity\n" in details
        assert re.search(ANSWERS[name], details)


VERBOSE = {  # command lines with -v, with the vehicles that the suite asks it of, and those that the attacks do
    f"sim.bump {ALL} --logs logs": f"/ {' '.join(ONE)} quarter_car quarter_car_semi_active half_car half_car_roll full_car",
    f"sim.drive {ALL} --class C --logs logs": f"quarter_car / {' '.join(ONE)} quarter_car_semi_active half_car full_car",
    "sim.sweep --controller all --timestep 4e-3": f"/ {' '.join(ONE)} quarter_car quarter_car_semi_active half_car full_car",
    "sim.margins --controller CONTROLLER --timestep 4e-3": f"/ {' '.join(ONE)} quarter_car half_car full_car",
    "synth": f"full_car / {' '.join(ONE)} quarter_car quarter_car_semi_active half_car half_car_roll",
    "synth --fragility": "/ quarter_car",
}


@pytest.mark.parametrize(
    ("car", "line"),
    [
        case
        for line, (some, _, more) in ((line, cars.partition("/")) for line, cars in VERBOSE.items())
        for case in (*((car, line) for car in some.split()), *attacks([(car, line) for car in more.split()]))
    ],
)
def test_details_of_all_controllers_fit_a_screen(car, line, tmp_path, monkeypatch, capsys):
    """With -v a command takes at most 40 lines of 80 columns for all controllers of a vehicle file.

    A table has a row for each controller, and one line names what is omitted and how to get it.
    """
    monkeypatch.chdir(tmp_path)
    name, *arguments = shlex.split(line.replace("CONTROLLER", ONE.get(car, "I")))
    main_of(name)([*arguments, "--vehicle", car, "-v"])
    out = capsys.readouterr().out
    assert too_wide(out) == []
    assert len(out.splitlines()) <= DETAIL_LINES
    if "all" in arguments:
        assert len(re.findall(r"^ *shown only with --controller NAME -v, or --json: ", out, re.M)) == 1
    if name in ANSWERS:
        check_answer(name, out)
    if name in ("sim.bump", "sim.drive"):
        (logged,) = Path("logs").glob("*.mcap")
        assert main_of("sim.inspect")([str(logged), "-v"]) == 0
        out = capsys.readouterr().out
        assert too_wide(out) == []
        assert len(out.splitlines()) <= DETAIL_LINES


def texts(found: object) -> set[str]:
    """Returns the values of a JSON object that are texts."""
    if isinstance(found, dict | list):
        return set().union(*map(texts, found.values() if isinstance(found, dict) else found))
    return {found} if isinstance(found, str) else set()


@pytest.mark.parametrize("name", in_the_suite({*CASES} - {"sim recommend"}, CASES))
def test_files(name):
    """JSON names each file that a golden run wrote."""
    run = golden(name, "plain")
    written = {path.relative_to(run.folder).as_posix() for path in run.folder.rglob("*") if path.is_file()}
    own = {"campaign-results/.lock", "campaign-results/plan.json", "campaign.toml"}  # of a campaign, beside its results
    assert written - texts(run.json) <= own


def test_log(tmp_path, monkeypatch, capsys):
    """The same of a log that is inspected, of several, and with -v, which prints more than a screen."""
    monkeypatch.chdir(tmp_path)
    assert (
        main_of("sim.bump")(["--vehicle", "full_car", "--controller", "I", "--duration", "0.2", "--timestep", "4e-3", "-v"]) == 0
    )
    capsys.readouterr()
    (log,) = Path("logs").glob("*.mcap")
    for name, function in (("log.read_log", read_log), ("proof.prove", prove)):
        monkeypatch.setattr(f"sim.inspect.{name}", functools.cache(function))  # proved once
    for more, short in (["--csv", "signals.csv"], True), (["-v"], False), ([str(log)] * 11, True):
        assert main_of("sim.inspect")([str(log), *more]) == 0
        out = capsys.readouterr().out
        assert too_wide(out) == []
        assert (len(out.splitlines()) <= LINES) == short
        assert re.fullmatch(ANSWERS["sim.inspect"] + ".*", out.splitlines()[-1])


def test_campaign(tmp_path, monkeypatch, capsys):
    """A campaign names its results and says who is best, `-v` shows its tables; --verify ends with its verdict."""
    pytest.importorskip("pyarrow", reason="needs the extra [campaign]")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    assert main_of("sim.campaign")(["campaign.toml", "--workers", "1", "-v"]) == 0
    out = capsys.readouterr().out
    assert too_wide(out) == []
    assert out.index("results.parquet") < out.index("full_car over bump at 10 m/s")
    assert main_of("sim.campaign")(["campaign.toml"]) == 0
    short = capsys.readouterr().out
    assert len(short.splitlines()) <= LINES < len(out.splitlines())
    assert out.endswith(short[short.index("\n\nfull_car\n") :])
    assert main_of("sim.campaign")(["--verify", "campaign-results", "--runs", "1"]) == 0
    out = capsys.readouterr().out
    assert too_wide(out) == []
    assert out.endswith("\n\nthe results agree with the campaign\n")


@pytest.mark.parametrize("name", ["sim", *(name for name, _, _ in COMMANDS)])
def test_help_pages(name, monkeypatch, capsys):
    """`--help` fits, examples too, has the options that the table of commands names, and ends with a page on the command."""
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as done:
        main_of(name)(["--help"])
    assert done.value.code == 0
    printed = capsys.readouterr().out
    for options in (options for known, _, options in COMMANDS if known == name):
        assert all(re.search(rf"^  {option}\b", printed, re.M) for option in options.split())
        assert f"roadproof {re.split('[. ]', name)[-1]} " in page(printed.strip().splitlines()[-1].partition(": ")[2])
    assert [line for line in printed.splitlines() if len(line) > WIDTH] == []
    for paragraph in re.findall(r"^(?!usage)(?:\S.*\n)+", printed.replace("\nexit code", "\n\nexit code"), re.M):
        assert wrap_text(" ".join(paragraph.splitlines()), hang=0) == paragraph.splitlines()
    examples = re.findall(r"^  ((?:python -m|roadproof) (?:.*\\\n)*.*)$", printed.partition("examples:")[2], re.M)
    assert examples
    for words in (shlex.split(each.replace("\\\n", "")) for each in examples):
        assert words[1] in VERBS or {words[2], " ".join(words[2:4])} & {*VERBS.values()}


def test_sentences_keep_their_words():
    """For random words of random lengths every line fits, none is lost, and no number is parted from its unit."""
    draw = random.Random(20261121)
    for _ in range(200):
        words = [draw.choice(("MuJoCo", "7.5 m/s", "-65 +- 3.2j", "a" * draw.randint(1, 30))) for _ in range(draw.randint(1, 60))]
        indent = " " * draw.randint(0, 8)
        text = indent + " ".join(words)
        lines = fit_lines([text])
        assert " ".join(" ".join(lines).split()) == text.strip()
        assert max(map(len, lines)) <= WIDTH
        assert not any(line.endswith((" 7.5", "+-")) for line in lines)
        assert lines[0].startswith(indent)
        assert all(line.startswith(f"{indent}  ") for line in lines[1:])


def test_sentences_fill_a_terminal():
    """A terminal shows as many sentences as it has room for, the first always, and the number of those that it leaves out."""
    sentences = ["one " * 30, "two", "three"]  # the first takes two lines
    for others, kept in ((0, 3), (20, 3), (21, 1), (23, 1), (30, 1)):
        lines = some_sentences(sentences, ["other"] * others)
        assert lines[0].startswith("one one")
        assert sum(line in ("two", "three") for line in lines) == kept - 1
        assert (lines[-1] == "-v prints 2 more sentences") == (kept == 1)
        assert others > 22 or len(lines) + others <= LINES
    assert some_sentences(["one", "two", "three"], ["other"] * 22) == ["one", "-v prints 2 more sentences"]
    assert some_sentences([], ["other"]) == []


def test_what_is_copied_is_not_cut():
    """A path that is marked so is one line, however long; a command goes on after a backslash, as a shell reads it."""
    path = Whole("  logs/" + "folder with spaces/" * 8)
    assert fit_lines([path]) == wrap_text(path) == [path]
    words = ["python -m synth", "--vehicle half_car", *(f"--controller a_controller_{i}" for i in range(9)), "--refine"]
    lines = command(words)
    assert max(map(len, lines)) <= WIDTH
    assert shlex.split("\n".join(lines).replace("\\\n", "")) == shlex.split(" ".join(words))


def test_tables_are_aligned():
    """Numbers end in their column's last place, and a name that leaves them no room has the line above."""
    lines = table(
        [("name", "one", "two"), ("short", "1.5", "200"), "a heading over all", ("n" * 76, "3", "-"), ("last", "44", "5")]
    )
    numbers = [line for line in lines if re.search(r"\d|one", line)]
    assert len({len(line) for line in numbers}) == 1
    assert lines[3:5] == [f"  {'n' * 76}", lines[4]]
    assert lines[4].split() == ["3", "-"]
    assert max(map(len, lines)) <= WIDTH


def test_shares_are_percent():
    """A share is printed with two digits, and never with a power of ten."""
    assert [percent(share) for share in (0.0, 1e-3, 0.994, 0.996, 1.0, 9.996, 1234.5)] == [
        *("0 %", "0.1 %", "99 %", "100 %", "100 %", "1000 %", "123450 %")
    ]
