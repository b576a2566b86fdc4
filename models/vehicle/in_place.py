"""Contents of files instead of their names in a vehicle file: laws, families, and tables of curves.

So the text of a vehicle is complete once it is read: logs, campaigns and saved files contain the numbers, and their readers never
open a file for them. A comment names the source.

A TOML file of a family has the key `family` of a section. A CSV file has a vehicle for every row: its header names parameters,
its numbers are factors on them.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from models.characteristics.curve_file import curve_tables
from models.common.errors import InputError, list_names, short_repr
from models.common.files import origin, parse_toml, path_from, reading
from models.common.table import find_table
from models.common.toml_edit import Replacement, with_replacements
from models.common.units import in_unit
from models.laws.law import LawSource
from models.vehicle.law_file import MATRICES, SAVE, read_law

KEY = "family"
GIVE_FAMILY = "give a .toml file with family = [{ ... }, ...], or a .csv file whose header names parameters"
GIVE_LAW = f"give a MATLAB file with A, B, C, D, or K, written by {SAVE}"


def with_contents(text: str, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """Returns a vehicle file's text with the contents of other files instead of their names, and those files.

    Args:
        folder: folder of the vehicle file, to which its paths are relative.

    Raises:
        InputError: the text is not TOML, or a file is missing or does not contain what it should; the message names it.
    """
    data = parse_toml(text)
    replacements = [*_families(data, folder), *_laws(data, folder), *curve_tables(data, folder)]
    return with_replacements(text, replacements), tuple(file for one in replacements for file in one.files)


def with_sections(text: str, lines: Sequence[str]) -> str:
    """Returns a vehicle file's text with lines added that are sections of controllers.

    Raises:
        InputError: the text has all controllers in one inline table, to which TOML allows no section to be added.
    """
    try:
        parse_toml(f'{text}\n[controllers.""]')
    except InputError as error:
        raise InputError(
            "no section can be added to controllers = { ... } of the vehicle file; write each one as [controllers.NAME]"
        ) from error
    return text.rstrip("\n") + "\n\n" + "\n".join(lines) + "\n"


def text_in(folder: Path, text: str, laws: Mapping[str, LawSource]) -> str:
    """Returns a vehicle file's text for another folder, with the paths of its laws in Python and FMUs relative to it.

    Args:
        folder: the new folder.
        laws: the sources of the laws, by controller.

    Raises:
        InputError: a law's file is not in the new folder or below, where alone a vehicle file can name it.
    """
    replacements = []
    for name, law in laws.items():
        for key, named in law.record_from(folder).items():
            if named != Path(law.record[key]).as_posix():
                replacements.append(Replacement(("controllers", name, key), {key: named}))
    return with_replacements(text, replacements)


def _entries(data: Mapping[str, Any], key: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yields name and section of each controller that has a key. Other values than sections are refused where they are read."""
    controllers = data.get("controllers")
    for name, entry in controllers.items() if isinstance(controllers, dict) else ():
        if isinstance(entry, dict) and key in entry:
            yield name, entry


def _families(data: Mapping[str, Any], folder: Path) -> Iterator[Replacement]:
    """Yields the families of vehicles that controllers name files for."""
    for name, entry in _entries(data, KEY):
        if isinstance(file := entry[KEY], str):
            path, read = path_from(file, folder), _of_toml if file.lower().endswith(".toml") else _of_csv
            with reading(path, f"[controllers.{name}] {KEY}", GIVE_FAMILY):
                content = path.read_bytes()
                family = read(content.decode("utf-8-sig").replace("\r\n", "\n"))
            yield Replacement(("controllers", name, KEY), {KEY: family}, origin(file, content), (path,))


def _of_toml(text: str) -> list[dict[str, Any]]:
    data = parse_toml(text)
    family = data.get(KEY)
    if set(data) != {KEY} or not isinstance(family, list) or not all(isinstance(member, dict) for member in family):
        raise InputError(f"the file must contain only {KEY}; {GIVE_FAMILY}")
    return family


def _of_csv(text: str) -> list[dict[str, Any]]:
    table = find_table(text, GIVE_FAMILY)
    names = [heading.text for heading in table.headings({})]
    return [dict(zip(names, row, strict=True)) for row in table.numbers()[0].tolist()]


def _laws(data: Mapping[str, Any], folder: Path) -> Iterator[Replacement]:
    """Yields the laws that controllers name MATLAB files for."""
    for name, entry in _entries(data, "file"):
        where, file = f"[controllers.{name}]", entry["file"]
        if not isinstance(file, str) or not file:
            raise InputError(f"{where} file = {short_repr(file)} is not the name of a file; {GIVE_LAW}")
        if others := [key for key in ("gain", "law", "fmu", *MATRICES) if key in entry]:
            raise InputError(
                f"{where} has both file and {list_names(others)}, but a file contains the whole law; omit one of them"
            )
        path = path_from(file, folder)
        with reading(path, f"{where} file", GIVE_LAW):
            content = path.read_bytes()
            law, period = read_law(content)
            if period is not None:
                given = in_unit(entry.get("sample_period", period), "s", "sample_period")
                if given != period:
                    raise InputError(f"its period is {period:g} s, but sample_period = {short_repr(given)}; omit sample_period")
                law |= {} if "sample_period" in entry else {"sample_period": period}
        yield Replacement(("controllers", name, "file"), law, origin(file, content), (path,))
