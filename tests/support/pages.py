"""The pages that a reader meets, cut into sections, and what stands in them run as it stands there."""

import glob
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.__main__ import VERBS
from tests.support.commands import main_of

ROOT = Path(__file__).parents[2]
# Kept in the repository (the reference without messages, the examples), or made when the site is built.
GENERATED = ("docs/reference/", "docs/gallery.md", "docs/examples.md", "docs/tutorials/notebook.md", "docs/_build/")
SITE = tuple(
    sorted(name for path in ROOT.glob("docs/**/*.md") if not (name := path.relative_to(ROOT).as_posix()).startswith(GENERATED))
)
PAGES = ("README.md", "models/README.md", "synth/README.md", "sim/README.md", "logs/README.md", *SITE)
PICTURES = ROOT / ".github" / "pictures"

# A command that takes long on its page runs with less to do here: what is added to its line, and why that says as much.
LIGHTER = {
    "sim.bump --vehicle full_car": "--duration 0.3 --no-logs",  # until the rear wheels have met the bump
    "sim.bump --vehicle half_car": "--duration 0.3 --no-logs",
    "sim.bump --vehicle quarter_car_accelerometer": "--duration 0.5 --no-logs",
    "sim.bump --controller passive --controller state": "--duration 0.5",
    "sim.bump --controller all": "--duration 0.5",
    "sim.bump --picture": "--no-logs",
    "sim.bump --vehicle my_car.toml": "--duration 0.5 --no-logs",
    "sim.bump --vehicle quarter_car --vehicle": "--duration 0.5 --no-logs",
    "sim.bump --vehicle quarter_car_semi_active": "--no-logs",
    "sim.bump --vehicle models/gallery/simulink_half_car": "--duration 0.5 --no-logs",
    "sim.bump --controller I --height": "--duration 0.5 --no-logs",
    "sim.bump --controller I --controller II": "--no-logs",
    "sim recommend": "--quick",  # a tenth of the candidates
    "sim.drive --controller I": "--no-logs",
    "sim.drive --controller passive": "--duration 1 --no-logs",  # a shorter stretch of the same road
    "sim.drive --vehicle full_car": "--duration 0.5",
    "sim.drive --vehicle half_car_roll": "--duration 0.5 --no-logs",
    "sim.bump --vehicle mr_car.toml": "--no-logs --duration 0.5",  # until the car is over the bump
    "sim.margins --controller I --vehicle half_car": "--timestep 0.002",  # fewer steps of the same bisections
    "sim.sweep --controller I": "--timestep 0.004",
    "sim.sweep --vehicle half_car": "--timestep 0.004",
    "sim.envelope --vehicle": "--timestep 0.004",
    "sim.envelope --controller II": "--timestep 0.004",  # fewer steps of the same cells
    "sim.campaign --verify": "--runs 4",
    "sim.report --out report": "--quick --timestep 0.004",  # test_report_numbers.py has whole reports
    "sim.report --quick": "--controller I --timestep 0.004",
}
# In a campaign file, and on its command's line.
THINNER = {
    "seeds = 100": "seeds = 1",
    "count = 16": "count = 1",
    "duration = 15.0": "settle = 0.5\nduration = 1.0",
    "--workers 8": "--workers 1",
}
ON_A_SCREEN = ("--open", "--serve")  # test_viewer.py has them
INSTALLS = re.compile("pip install|git clone|-m venv")  # the main job and the tests: .ci/run has them, from nothing


@dataclass(frozen=True)
class Section:
    """The text under one heading of a page.

    Attributes:
        page: its path from the root of the project.
        heading: of the section; of what comes before the first, the title of a page of the site, empty for the others.
        text: from there to the next one.
    """

    page: str
    heading: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}: {self.heading}"

    def blocks(self, language: str) -> list[str]:
        """Its fenced blocks in a language."""
        return re.findall(rf"^```{language}\n(.*?)^```", self.text, re.M | re.S)

    @property
    def commands(self) -> list[str]:
        """The lines of its sh and zsh blocks, but those that install; `roadproof VERB` is `python -m` of its module."""
        blocks = [*self.blocks("sh"), *self.blocks("zsh")]
        lines = [line for block in blocks for line in block.splitlines() if line and not INSTALLS.search(line)]
        return [re.sub(r"^roadproof (\w+)", lambda verb: f"python -m {VERBS[verb[1]]}", line) for line in lines]


def page(name: str) -> str:
    """The text of a page."""
    return (ROOT / name).read_text(encoding="utf-8")


def sections(name: str) -> Iterator[Section]:
    """The sections of a page."""
    first, *rest = page(name).split("\n## ")
    yield Section(name, first.splitlines()[0].removeprefix("# ") if name in SITE else "", first)
    for part in rest:
        heading, _, text = part.partition("\n")
        yield Section(name, heading, text)


def section(name: str, heading: str) -> Section:
    """The one section of a page whose heading begins so."""
    (found,) = [each for each in sections(name) if each.heading.startswith(heading)]
    return found


def site(heading: str) -> Section:
    """The one section of the site whose heading begins so."""
    (found,) = [each for name in SITE for each in sections(name) if each.heading.startswith(heading)]
    return found


def hopper(folder: Path) -> Path:
    """The vehicle of "Add a custom vehicle type", its three files written to a folder; the path of the vehicle file."""
    recipe = site("Add a custom vehicle type")
    for suffix, language in (("py", "python"), ("xml", "xml"), ("toml", "toml")):
        (block,) = recipe.blocks(language)
        (folder / f"hopper.{suffix}").write_text(block, encoding="utf-8", newline="\n")
    return folder / "hopper.toml"


def copied(folder: Path, *names: str) -> None:
    """Copies folders of the project, with their bytecode, so that only what a test changes is compiled again."""
    for name in names:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.mcap", "*.rrd", "_build", "*-pytest-*"))


def thinner(text: str) -> str:
    """A campaign's file or line with less to do."""
    for much, less in THINNER.items():
        text = text.replace(much, less)
    return text


def run(one: Section, folder: Path) -> None:
    """Runs a section's commands in an empty folder that is the working directory, with /tmp of the page below it.

    Raises:
        AssertionError: one does not exit with 0.
    """
    (folder / "tmp").mkdir()
    (folder / "models").mkdir()
    for path in (ROOT / "models").glob("*.toml"):
        shutil.copy(path, folder / "models")
    shutil.copytree(ROOT / "models" / "gallery", folder / "models" / "gallery")
    for campaign in one.blocks("toml"):
        named = re.match(r"# (\w+\.toml)\n", campaign)
        (folder / (named[1] if named else "campaign.toml")).write_text(thinner(campaign), encoding="utf-8", newline="\n")
    for line in one.commands:
        line = thinner(line.replace(" /tmp/", " tmp/"))
        if not line.startswith("python -m "):
            subprocess.run(["sh", "-ec", line], cwd=folder, check=True)
            continue
        lighter = [more for start, more in LIGHTER.items() if line.startswith(f"python -m {start}")]
        for option in re.findall(r"--duration|--timestep", " ".join(lighter)):
            line = re.sub(rf" {option} \S+", "", line)
        module, *words = shlex.split(" ".join([line, *lighter]))[2:]
        arguments = [each for word in words for each in (sorted(glob.glob(word)) or [word]) if word not in ON_A_SCREEN]
        code = main_of(module)(arguments)
        assert code == 0, f"exit code {code} of {line}"


def missing(text: str, printed: str) -> str | None:
    """The first line of a page's text block that was not printed after those above it; `...` stands for anything."""
    place = 0
    for line in text.splitlines():
        if line.strip() in ("", "..."):
            continue
        pattern = "^" + ".*".join(re.escape(part) for part in line.split("...")) + ("" if line.endswith("...") else "$")
        found = re.compile(pattern, re.M).search(printed, place)
        if found is None:
            return line
        place = found.end()
    return None


def same_picture(drawn: Path, shown: Path) -> bool:
    """Returns True if two pictures are one, but for the edges of letters."""
    from matplotlib.image import imread

    one, other = imread(drawn), imread(shown)
    # Other fonts and versions of Matplotlib move letters by a pixel; another curve, or another cell, is more than that.
    return one.shape == other.shape and float(np.mean(np.abs(one - other).max(axis=-1) > 0.1)) < 0.01
