"""Contents of law and family files in place of their names: a law's matrices, or a family's members.

So a vehicle file is whole once it is read: logs, campaigns and saved files hold the matrices, and their readers never open a file
for them. A comment names the source.

A TOML file of a family has the key `family` of a section. A CSV file has a vehicle for every row: its header names parameters,
its numbers are factors on them.
"""

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array, real_matrix
from models.common.errors import InputError, first_few, listing, quoted
from models.common.files import MIB, TEXT, decoded, origin, parse_toml, read_bytes, reading
from models.common.table import find_table
from models.common.units import in_unit
from models.laws.python_law import PythonLaw
from models.vehicle.mat_file import SAVE, Variable, read_mat


def controllers_of(text: str) -> dict[str, Any]:
    """Returns `[controllers]` of a vehicle file's text; empty if it has no such section.

    Raises:
        InputError: the text is not TOML.
    """
    sections = parse_toml(text).get("controllers")
    return sections if isinstance(sections, dict) else {}


def with_sections(text: str, lines: Sequence[str]) -> str:
    """Returns a vehicle file's text with lines added that are sections of controllers.

    Raises:
        InputError: the text gives all controllers as one inline table, beside which TOML has no section.
    """
    try:
        parse_toml(f'{text}\n[controllers.""]')
    except InputError as error:
        raise InputError(
            "the vehicle file has controllers = { ... }, which none can be added to; write each as a section [controllers.NAME]"
        ) from error
    return text.rstrip("\n") + "\n\n" + "\n".join(lines) + "\n"


def in_place_of(text: str, key: str, given: Mapping[str, str]) -> str:
    """Returns a vehicle file's text with other lines in place of those that give a key a file's name.

    A key that is not on a line of its own stays as it is: the caller has to check the result.

    Args:
        key: key of controllers' sections.
        given: the new lines, by controller.
    """
    line = re.compile(rf"^[ \t]*{key}[ \t]*=[^\n]*$", re.M)
    # Each such line is replaced by its position once, so that the parser assigns the lines to controllers.
    lines = {str(match.start()): match for match in line.finditer(text)}
    try:
        marked = controllers_of(line.sub(lambda match: f'{key} = "{match.start()}"', text))
    except InputError:
        marked = {}
    place = {name: str(marked.get(name, {}).get(key)) for name in given}
    for name in sorted(given, key=lambda name: -int(place[name]) if place[name] in lines else 0):
        if place[name] in lines:
            start, end = lines[place[name]].span()
            text = text[:start] + given[name] + text[end:]
    return text


def text_in(folder: Path, text: str, laws: Mapping[str, PythonLaw]) -> str:
    """Returns a vehicle file's text for another folder, from which its laws in Python are named.

    Args:
        folder: the new folder.
        laws: the laws that have files, by controller.

    Raises:
        InputError: a law's file is not in the new folder or below, where alone a vehicle file can name it.
    """
    places = {
        name: os.path.relpath(os.path.realpath(law.path or law.file), os.path.realpath(folder)) for name, law in laws.items()
    }
    for name, place in places.items():
        if place.startswith(os.pardir):
            raise InputError(f"its law {laws[name].law} would be outside of {folder}")
    for key in ("law", "fmu"):
        some = {name: place for name, place in places.items() if laws[name].is_fmu == (key == "fmu")}
        ends = {name: "" if key == "fmu" else f":{laws[name].function}" for name in some}
        named = {name: f"{Path(place).as_posix()}{ends[name]}" for name, place in some.items()}
        named = {name: law for name, law in named.items() if law != Path(laws[name].law).as_posix()}
        text = in_place_of(text, key, {name: f"{key} = {json.dumps(law, ensure_ascii=False)}" for name, law in named.items()})
        for name, law in named.items():
            if controllers_of(text)[name].get(key) != law:
                raise InputError(f'[controllers.{name}] its law is not named on a line of its own; write {key} = "{law}" on one')
    return text


KEY = "family"
GIVE_FAMILY = "give a .toml file with family = [{ ... }, ...], or a .csv file whose header names parameters"


def with_families(text: str, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """Returns a vehicle file's text with families in place of their files, and those files.

    Args:
        folder: folder of the vehicle file, to which its paths are relative.

    Raises:
        InputError: the text is not TOML, or a file is missing, or holds no family; the message names it.
    """
    named = {
        name: entry[KEY]
        for name, entry in controllers_of(text).items()
        if isinstance(entry, dict) and isinstance(entry.get(KEY), str)
    }
    if not named:
        return text, ()
    given, families, files = {}, {}, []
    for name, file in named.items():
        try:
            families[name], comment = _read_family(file, folder)
        except InputError as error:
            raise InputError(f"[controllers.{name}] {error}") from error
        given[name] = f"{comment}\n{KEY} = [{', '.join(map(_table, families[name]))}]"
        files.append(folder / file)
    whole = in_place_of(text, KEY, given)
    for name, family in families.items():
        if repr(controllers_of(whole)[name].get(KEY)) != repr(family):  # NaN is not NaN; it is refused where a member is read
            raise InputError(f'[controllers.{name}] its {KEY} is not named on a line of its own; write {KEY} = "NAME.csv" on one')
    return whole, tuple(files)


def _read_family(file: str, folder: Path) -> tuple[list[dict[str, Any]], str]:
    """Returns the members in a file, and a comment with its source."""
    path = folder / file
    content = read_bytes(path, KEY, GIVE_FAMILY)
    text = decoded(content, path, KEY, GIVE_FAMILY)
    with reading(path, KEY, GIVE_FAMILY):
        family = (_of_toml if path.suffix.lower() == ".toml" else _of_csv)(text)
    return family, origin(file, content)


def _of_toml(text: str) -> list[dict[str, Any]]:
    data = parse_toml(text)
    family = data.get(KEY)
    if set(data) != {KEY} or not isinstance(family, list) or not all(isinstance(member, dict) for member in family):
        raise InputError(f"holds no {KEY} alone; {GIVE_FAMILY}")
    return family


def _of_csv(text: str) -> list[dict[str, Any]]:
    table = find_table(text, GIVE_FAMILY)
    names = [heading.text for heading in table.headings({})]
    return [dict(zip(names, row, strict=True)) for row in table.numbers()[0].tolist()]


def _table(member: dict[str, Any]) -> str:
    """Returns a member on one line of TOML."""
    numbers = {name: repr(value) if isinstance(value, float) else json.dumps(value) for name, value in member.items()}  # NaN, too
    return "{ " + ", ".join(f"{json.dumps(name)} = {number}" for name, number in numbers.items()) + " }"


MATRICES = ("A", "B", "C", "D")
PERIODS = ("Ts", "sample_period")
NAMES = (*MATRICES, "K", *PERIODS)
DELAYS = ("InputDelay", "OutputDelay", "IODelay", "ioDelay", "InternalDelay")
FIELDS = ("E", *DELAYS, "TimeUnit")  # further fields of a struct made by get(sys)
MOST = 64 * MIB  # of a file: it may hold a whole workspace
GIVE_LAW = "give a MATLAB file with A, B, C, D, or K"


def with_laws(text: str, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """Returns a vehicle file's text with matrices in place of their files, and those files.

    Args:
        folder: folder of the vehicle file, to which its paths are relative.

    Raises:
        InputError: the text is not TOML, or a file is missing, of another format, or holds no controller; the message names it.
    """
    sections = controllers_of(text)
    named = {name: entry for name, entry in sections.items() if isinstance(entry, dict) and "file" in entry}
    if not named:
        return text, ()
    records, comments, files = {}, {}, []
    for name, entry in named.items():
        try:
            records[name], comments[name], file = _read_law(entry, folder)
        except InputError as error:
            raise InputError(f"[controllers.{name}] {error}") from error
        files.append(file)

    given = {name: "\n".join([comments[name], *lines_of(records[name])]) for name in named}
    whole = in_place_of(text, "file", given)
    if len(whole.encode()) > TEXT:
        raise InputError(f"with the matrices of its files it has more than {TEXT / MIB:g} MiB; reduce the controllers' order")
    controllers = controllers_of(whole)
    for name, entry in named.items():
        if controllers.get(name) != {key: value for key, value in entry.items() if key != "file"} | records[name]:
            raise InputError(f'[controllers.{name}] its file is not named on a line of its own; write file = "NAME.mat" on one')
    return whole, tuple(files)


def lines_of(record: Mapping[str, Any]) -> list[str]:
    """Returns lines of TOML."""
    return [f"{key} = {json.dumps(value)}" for key, value in record.items()]


def _read_law(entry: Mapping[str, Any], folder: Path) -> tuple[dict[str, Any], str, Path]:
    """Returns the law in an entry's file, as TOML has it; a comment with its source; and the file."""
    file = entry["file"]
    if not isinstance(file, str) or not file:
        raise InputError(f"file = {quoted(file)} is no file's name; {GIVE_LAW}")
    beside = [key for key in ("gain", "law", "fmu", *MATRICES) if key in entry]
    if beside:
        raise InputError(f"has a file and {listing(beside)}; a file is whole by itself, so leave one out")
    path = folder / file
    content = read_bytes(path, "file", GIVE_LAW)
    try:
        variables, others = read_mat(content, NAMES, FIELDS)
        record, period = _law(variables, others, path.name)
    except InputError as error:
        raise InputError(f"file {path}: {error}") from error
    if period is not None:
        said = in_unit(entry.get("sample_period", period), "s", "sample_period")
        if said != period:
            raise InputError(f"file {path}: has a sample period of {period:g} s, and sample_period = {quoted(said)} is another")
        record |= {} if "sample_period" in entry else {"sample_period": period}
    return record, origin(file, content), path


def _law(variables: Mapping[str, Variable], others: Mapping[str, str], file: str) -> tuple[dict[str, Any], float | None]:
    """Returns the one law in a file, as TOML has it, and its sample period; None for a continuous or static law."""
    loose = {name: value for name, value in variables.items() if not isinstance(value, dict)}
    places = {"the file": loose} | {f"the struct {name}": value for name, value in variables.items() if isinstance(value, dict)}
    holding = {where: values for where, values in places.items() if {*values} & {*MATRICES, "K"}}
    if not holding:
        opaque = [name for name, what in others.items() if what.startswith("a MATLAB object")]
        if opaque:
            name = opaque[0]
            raise InputError(
                f"{name} is {others[name]}, which only MATLAB reads; there, say [A, B, C, D, Ts] = ssdata({name}); "
                f"save('{file}', 'A', 'B', 'C', 'D', 'Ts', '-v7')"
            )
        there = [f"{name}, {what}" for name, what in others.items()] + [name for name in variables]
        raise InputError(f"holds no A, B, C, D, and no K; it has {first_few(there) or 'nothing'}: {SAVE}")
    if len(holding) > 1:
        raise InputError(f"holds more than one controller, in {' and '.join(holding)}; keep one")
    ((where, matrices),) = holding.items()
    gains = [name for name in ("K", "D") if name in matrices]
    if {"A", "B", "C"} & {*matrices}:
        missing = [name for name in MATRICES if name not in matrices]
        if missing:
            raise InputError(f"{listing(missing)} is missing in {where}; give A, B, C and D, or K alone")
    if "K" in matrices and {*MATRICES} & {*matrices}:
        raise InputError(f"{where} has K beside {listing({*MATRICES} & {*matrices})}; keep K, a static gain, or A, B, C and D")
    _check_plain(matrices)
    static = "A" not in matrices or not matrices["A"].size
    if static:
        return {"gain": _numbers(gains[0], matrices[gains[0]]).tolist()}, None
    return {name: _numbers(name, matrices[name]).tolist() for name in MATRICES}, _period(matrices)


def _numbers(name: str, value: Array) -> Array:
    """Returns a matrix of real finite numbers; the law checks their size."""
    return real_matrix(value, name, np.inf)[0]


def _check_plain(matrices: Mapping[str, Array]) -> None:
    """Refuses a struct of a system with more than its matrices, if that would change the law."""
    E = matrices.get("E", np.zeros((0, 0)))
    if E.size and not np.array_equal(E, np.eye(len(E))):
        raise InputError("has an E that is not the identity; give x' = A x + B y without one, by ss(sys, 'explicit') in MATLAB")
    delayed = [name for name in DELAYS if np.any(matrices.get(name, 0))]
    if delayed:
        raise InputError(
            f"has {', '.join(delayed)} above 0, and a law has no delay; give one to [implementation], or take pade(sys, 3)"
        )
    unit = "".join(chr(int(code)) for code in np.real(matrices.get("TimeUnit", np.zeros(0))).ravel())
    if unit not in ("", "seconds"):
        raise InputError(f"TimeUnit is {quoted(unit)}; give seconds, by chgTimeUnit(sys, 'seconds') in MATLAB")


def _period(matrices: Mapping[str, Array]) -> float | None:
    """Returns the sample period [s]; None for a continuous law, whose period MATLAB writes as 0."""
    periods = {}
    for name in PERIODS:
        if name in matrices:
            value = _numbers(name, matrices[name])
            if value.size != 1 or value.item() < 0:
                raise InputError(f"{name} = {quoted(value)} is no sample period; give seconds, or 0 for a continuous law")
            periods[name] = value.item()
    if len({*periods.values()}) > 1:
        raise InputError("Ts and sample_period are two sample periods; keep one")
    return next(iter(periods.values()), 0.0) or None
