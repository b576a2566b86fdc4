"""Replacement of the names of files (control laws, vehicle families and tables) in a vehicle file by the contents of these
files.

After the replacement, the text of a vehicle is complete: logs, campaigns and saved files contain all numbers, so they can be
read without other files. A comment in the text of the vehicle names the file from which the numbers were read.

A TOML file with a family contains only the key `family`, as in a controller's section. A CSV file with a family has a row for
each vehicle. The header of the CSV file contains names of parameters, and the numbers are factors on these parameters.
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
    """Replaces the names of files in the text of a vehicle file by the contents of these files.

    Args:
        text: text of the vehicle file.
        folder: folder of the vehicle file. Paths in the vehicle file are relative to `folder`.

    Returns:
        The complete text, and the paths of the files whose contents it contains.

    Raises:
        InputError: the text is not TOML, or a file is missing or has invalid contents. The error message contains the name of
            the file.
    """
    data = parse_toml(text)
    replacements = [*_families(data, folder), *_laws(data, folder), *curve_tables(data, folder)]
    return with_replacements(text, replacements), tuple(file for one in replacements for file in one.files)


def with_sections(text: str, lines: Sequence[str]) -> str:
    """Returns the text of a vehicle file, to which lines with sections of controllers are added.

    Raises:
        InputError: the text has all controllers in one inline table. TOML does not allow additional sections if `controllers`
            is an inline table.
    """
    try:
        parse_toml(f'{text}\n[controllers.""]')
    except InputError as error:
        raise InputError(
            "no controller can be added, because the vehicle file has controllers = { ... }, to which TOML allows no further "
            "sections; write each controller as [controllers.NAME]"
        ) from error
    return text.rstrip("\n") + "\n\n" + "\n".join(lines) + "\n"


def text_in(folder: Path, text: str, laws: Mapping[str, LawSource]) -> str:
    """Returns the text of a vehicle file after adapting it to a new folder. Paths of Python laws and FMUs become relative to
    the new folder.

    Args:
        folder: folder to which the vehicle file is written.
        text: text of the vehicle file.
        laws: sources of the control laws, by controller.

    Raises:
        InputError: the file of a law is not in the new folder or in one of its subfolders, as vehicle files require.
    """
    replacements = []
    for name, law in laws.items():
        for key, named in law.record_from(folder).items():
            if named != Path(law.record[key]).as_posix():
                replacements.append(Replacement(("controllers", name, key), {key: named}))
    return with_replacements(text, replacements)


def _entries(data: Mapping[str, Any], key: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yields the name and the section of each controller whose section contains a given key.

    Values that are not sections are skipped, because other functions refuse these values.
    """
    controllers = data.get("controllers")
    for name, entry in controllers.items() if isinstance(controllers, dict) else ():
        if isinstance(entry, dict) and key in entry:
            yield name, entry


def _families(data: Mapping[str, Any], folder: Path) -> Iterator[Replacement]:
    """Yields the vehicle families that controllers read from files."""
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
    """Yields the control laws that controllers read from MATLAB files."""
    for name, entry in _entries(data, "file"):
        where, file = f"[controllers.{name}]", entry["file"]
        if not isinstance(file, str) or not file:
            raise InputError(f"{where} file = {short_repr(file)} is not the name of a file; {GIVE_LAW}")
        if others := [key for key in ("gain", "law", "fmu", *MATRICES) if key in entry]:
            raise InputError(
                f"{where} has both file and {list_names(others)}, but the file contains the whole law; omit file or "
                f"{list_names(others)}"
            )
        path = path_from(file, folder)
        with reading(path, f"{where} file", GIVE_LAW):
            content = path.read_bytes()
            law, period = read_law(content)
            if period is not None:
                given = in_unit(entry.get("sample_period", period), "s", "sample_period")
                if given != period:
                    raise InputError(
                        f"the law in the file has a sample period of {period:g} s, but the section has sample_period = "
                        f"{short_repr(given)}; omit sample_period"
                    )
                law |= {} if "sample_period" in entry else {"sample_period": period}
        yield Replacement(("controllers", name, "file"), law, origin(file, content), (path,))
