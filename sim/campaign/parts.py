"""Parts of a campaign, for the job queue of a cluster: each part is one job.

The machines of the cluster need a shared folder, but the file system need not support file locks. The jobs of a campaign can
run in any order.

The results folder contains a folder `parts` with the plan of the campaign, which the first job writes when it starts. `parts`
also contains a folder for each part, such as `3-of-40`, with its own copy of the plan. The option `--merge` joins the results
in the folders of all parts to the results of the whole campaign.
"""

import itertools
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from models.common.errors import InputError
from sim.campaign.manifest import NAME, PARTS, RESULTS, Manifest, read_manifest

MOST_PARTS = 100_000
FOLDER = re.compile(r"([1-9]\d*)-of-([1-9]\d*)")
AGAIN = "remove this folder, and run its part again"


@dataclass(frozen=True, order=True)
class CampaignPart:
    """One of the parts into which a campaign is divided.

    Attributes:
        of: total number of parts.
        number: number of the part, from 1 to `of`.
    """

    of: int
    number: int

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    def folder(self, campaign: Path) -> Path:
        """Returns the folder for the results of a part. `campaign` is the results folder of the whole campaign."""
        return campaign / PARTS / f"{self.number}-of-{self.of}"


def part_of(text: str) -> CampaignPart:
    """Returns the part for the value K/N of the option `--part`.

    Raises:
        InputError: the value does not have the form K/N, or K is not between 1 and N.
    """
    found = re.fullmatch(r"\s*(\d{1,9})\s*/\s*(\d{1,9})\s*", text)
    number, of = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= of <= MOST_PARTS:
        allowed = f"give K/N, with K from 1 to N and N up to {MOST_PARTS}, as in 3/40"
        raise InputError(f"--part {text}: this is not a part of a campaign; {allowed}")
    return CampaignPart(of, number)


def there(folder: Path) -> list[CampaignPart]:
    """Returns the parts of a campaign that have a folder in its results folder, in ascending order.

    Raises:
        InputError: parts overlap, because the campaign was divided into different numbers of parts.
    """
    names = [match for path in (folder / PARTS).glob("*-of-*") if (match := FOLDER.fullmatch(path.name))]
    parts = sorted(CampaignPart(int(name[2]), int(name[1])) for name in names if int(name[1]) <= int(name[2]))
    check_overlap(folder, parts)
    return parts


def check_overlap(folder: Path, parts: Sequence[CampaignPart]) -> None:
    """Checks that all part folders belong to the same division of the campaign, that is, to the same total number of parts. If
    the total numbers of parts differ, some runs belong to two parts.

    Raises:
        InputError: two parts contain the same runs.
    """
    if parts and parts[0].of != parts[-1].of:
        raise InputError(
            f"{folder / PARTS}: the parts {parts[0]} and {parts[-1]} of this campaign overlap, because the "
            "campaign was divided differently; use the same number of parts in each run, or give a different folder with "
            "--results"
        )


def unfinished_parts(folder: Path, of: int) -> list[int]:
    """Returns the numbers of the parts that have no results yet."""
    return [number for number in range(1, of + 1) if not (CampaignPart(of, number).folder(folder) / RESULTS).exists()]


def parts_text(numbers: Sequence[int], of: int) -> str:
    """Returns the numbers of parts as text, such as "parts 4, 7-9 of 40"."""
    runs = [[number for _, number in some] for _, some in itertools.groupby(enumerate(numbers), lambda one: one[1] - one[0])]
    said = ", ".join(f"{run[0]}-{run[-1]}" if run[1:] else str(run[0]) for run in runs)
    return f"part{'s' * (len(numbers) > 1)} {said} of {of}"


def begin(folder: Path, part: CampaignPart, plan: Manifest) -> None:
    """Writes the plan of the campaign to the folder of a part, unless the folder already contains a plan.

    Raises:
        InputError: the folder contains other files, or the plan cannot be written.
    """
    own = part.folder(folder)
    if read_manifest(own, AGAIN) is None:
        replace(plan, part=str(part)).write(own)


def check(folder: Path, part: CampaignPart, plan: Manifest, digest: str, versions: Mapping[str, str]) -> None:
    """Checks that the folder of a part belongs to this campaign, and that gains and package versions are those of the campaign.

    Raises:
        InputError: the folder contains a different part, or a part with a different campaign, different gains or different
            package versions.
    """
    own = part.folder(folder)
    manifest = read_manifest(own, AGAIN)
    if manifest is None or manifest.part != str(part):
        raise InputError(
            f"{own} should contain part {part} of the campaign, but contains "
            f"{'nothing' if manifest is None else manifest.part}; {AGAIN}"
        )
    manifest.check(own, digest, versions, AGAIN)
    if manifest.controllers != plan.controllers:
        raise InputError(f"part {part} was simulated with gains that differ from the gains in {folder / PARTS / NAME}; {AGAIN}")


def check_complete(folder: Path, parts: Sequence[CampaignPart]) -> None:
    """Checks that all parts exist and are finished.

    Raises:
        InputError: no part exists, or some parts are missing or unfinished.
    """
    if not parts:
        raise InputError(
            f"--merge: {folder} contains no finished part of a campaign; first run each part with --part, as in --part 1/40"
        )
    of = parts[0].of
    if left := unfinished_parts(folder, of):
        begun = {part.number for part in parts}
        kinds = {"missing": [one for one in left if one not in begun], "not finished": [one for one in left if one in begun]}
        found = [f"{parts_text(some, of)} {'is' if len(some) == 1 else 'are'} {kind}" for kind, some in kinds.items() if some]
        raise InputError(f"{folder}: {' and '.join(found)}; run these parts with --part, then merge all parts again")


def remove(folder: Path) -> None:
    """Removes the folders of all parts after the campaign is merged."""
    for path in (folder / PARTS, *folder.glob(f".{PARTS}.*")):
        shutil.rmtree(path, ignore_errors=True)
