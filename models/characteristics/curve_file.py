"""Files that contain characteristics, and to which a vehicle file refers by `file = "damper.csv"` or `stop = "bump.csv"`.

When a vehicle file is read, the tables replace the names of the files that contain them, so later steps need only the vehicle
file. The names of files with control laws or vehicle families are also replaced by the contents of these files. Tables in
CSV, `.xlsx` or `.mat` files have a header with quantity and unit of each column: `velocity [mm/s], force [kN]`. Damper property
files (`.dpr`) of Adams/Car have the TeimOrbit format. A TeimOrbit file consists of blocks in brackets, tables below a row of
names in braces, and comments after `$` or `!`. The block `[UNITS]` contains the units, and the block `[CURVE]` contains the
table. Sources: MSC Software, Adams Tire help, "About tire property files"; Altair MotionView help, READ_T_O_START_TABLE_READ.
"""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.characteristics import RATIO, STOP, STOP_NAMES
from models.characteristics.curve_log import dissipation, velocity_of
from models.characteristics.measured_loop import mean_of_loop
from models.characteristics.surface_table import surface_columns
from models.common.arrays import Array
from models.common.errors import InputError, list_names, short_repr
from models.common.files import origin, path_from, reading
from models.common.printed import rough
from models.common.quantities import QUANTITIES, Heading, columns_in_words, left_out_words
from models.common.table import find_table, table_text
from models.common.toml_edit import Replacement
from models.common.units import QUANTITY, unit_size

GIVE = "give a .csv file with a header such as velocity [m/s], force [N], or a .dpr file"
GIVE_MATLAB = "give vectors with names such as velocity_m_s and force_N"
ARGUMENTS = ("velocity", "deflection")
# Words by which a heading names a velocity or a deflection that is positive in extension
SIGN_HEADINGS = {"velocity": {"velocity", "vel", "v", "geschwindigkeit", "vitesse"}, "deflection": {"deflection"}}
ROLES = {  # words by which a heading names each quantity
    "force": {"force", "load", "kraft", "effort"},
    "velocity": {*SIGN_HEADINGS["velocity"], "speed"} - {"v"},
    "deflection": {"deflection", "displacement"},
    "time": {"time", "t", "timestamp", "zeit", "temps"},
}
LOG = ("time", "deflection", "force")  # columns of a dynamometer log from which the velocity can be computed
GAS = 0.02  # a force at velocity 0 counts as gas force only if it is above this share of the largest force
BLOCK = re.compile(r"^\s*\[\s*([^\]]+?)\s*\]\s*$(.*?)(?=^\s*\[|\Z)", re.M | re.S)
HEAD = re.compile(r"\{(.*?)\}")


def curve_tables(data: Mapping[str, Any], folder: Path) -> Iterator[Replacement]:
    """Yields, for each file name of a characteristic or stop in a vehicle file, the table that replaces the name.

    Args:
        data: content of the vehicle file as TOML tables.
        folder: folder of the vehicle file, to which paths are relative.

    Raises:
        InputError: a file is missing, or does not contain a characteristic. The message contains the path of the file.
    """
    for path, entry in _with_files(data):
        sources: list[tuple[str, Path]] = []
        whole, key = (path, path[-1]) if isinstance(entry, (list, str)) else ((*path, "file"), "")
        try:
            if isinstance(entry, str):
                new: Any = _read({"file": entry}, folder, path, sources)
            elif isinstance(entry, list):
                new = [_without_file(one) | _read(one, folder, path, sources) if _names_file(one) else one for one in entry]
            else:
                new = _read(entry, folder, path, sources)
        except InputError as error:
            raise InputError(f"[{'.'.join(path[:-1])}] {path[-1]}: {error}") from error
        comment, files = "; ".join(source for source, _ in sources), tuple(file for _, file in sources)
        yield Replacement(whole, {key: new} if key else new, comment, files)


def _with_files(data: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yields those entries of characteristics, dampers and stops that contain file names, each with the keys that lead to the
    entry.
    """
    for section in ("curves", "actuators"):
        yield from _entries_with_files(data.get(section), (section,))
    limits = data.get("limits")
    places = {(): limits} | ({(name,): one for name, one in limits.items()} if isinstance(limits, dict) else {})
    for place, section in places.items():
        for key in STOP_NAMES:
            if isinstance(section, dict) and key in section:
                yield from _entries_with_files(section[key], ("limits", *place, key), texts=key == STOP)


def _entries_with_files(entry: Any, path: tuple[str, ...], texts: bool = False) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yields an entry if it contains a file name, or otherwise all entries below it that contain file names.

    Args:
        entry: entry of the vehicle file.
        path: keys that lead to the entry.
        texts: True if every text in the entry is a file name, except numbers with a unit.
    """
    named = isinstance(entry, str) and texts and not _is_quantity(entry)
    if named or _names_file(entry) or (isinstance(entry, list) and any(map(_names_file, entry))):
        yield path, entry
    elif isinstance(entry, dict):
        for name, one in entry.items():
            yield from _entries_with_files(one, (*path, name), texts)


def _names_file(entry: Any) -> bool:
    return isinstance(entry, dict) and "file" in entry


def _is_quantity(text: str) -> bool:
    """Returns True if a text is a number with a unit of any dimension."""
    match = QUANTITY.fullmatch(text)
    return match is not None and unit_size(match[2], match[2]) is not None


def _without_file(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if key != "file"}


def _argument(path: tuple[str, ...]) -> str:
    """Returns the variable on which the force of an entry depends, or "ratio" for a motion ratio; empty for a parameter with a
    custom name.
    """
    if path[0] == "limits":
        return "compression"
    if path[0] == "actuators" or "damping" in path[-1]:
        return "velocity"
    if "motion_ratio" in path[-1]:
        return RATIO
    return "deflection" if "stiffness" in path[-1] else ""


def _read(entry: Mapping[str, Any], folder: Path, path: tuple[str, ...], sources: list[tuple[str, Path]]) -> dict[str, Any]:
    """Returns the table in a file in the form of an entry of the vehicle file, and adds the source of the table to `sources`."""
    name = entry["file"]
    if not isinstance(name, str) or not name:
        raise InputError(f"file = {short_repr(name)} is not the name of a file; {GIVE}")
    if others := [key for key in (*ARGUMENTS, "compression", "force", "note") if key in entry]:
        raise InputError(
            f"has both a file and {list_names(others)}, but the file contains the whole table; omit the file, or "
            f"{list_names(others)}"
        )
    file, over = path_from(name, folder), _argument(path)
    with reading(file, "curve", GIVE):
        content = file.read_bytes()
        text = _dpr_columns(table_text(file)) if name.lower().endswith(".dpr") else table_text(file)
        give = GIVE_MATLAB if name.lower().endswith(".mat") else GIVE
        table = _of_ratio(text) if over == RATIO else surface_columns(text, give) or _of_columns(text, over, give)
        if over and over not in table:
            other = "deflection" if over == RATIO else "force"
            raise InputError(f"has the columns {list_names(table)}; the columns {over} and {other} are needed")
    sources.append((origin(name, content), file))
    return table


def _of_columns(text: str, over: str, give: str) -> dict[str, Any]:
    """Returns the table of a characteristic in SI units. All values are positive if the suspension extends, but the values of a
    stop are positive in compression.

    The words in the headings determine the signs of the values. The data sheet of a damper dynamometer has a speed v, a rebound
    force and a compression force in each row. The force F(v) at the speed v of a row is the rebound force, and F(-v) is minus
    the compression force. A table whose argument goes back and forth is a measured hysteresis loop.

    Args:
        text: content of the file.
        over: argument of the force: "velocity", "deflection", or "compression" for a stop; empty if it may be velocity or
            deflection.
        give: description of the content that the file must have, for messages.
    """
    table = find_table(text, give)
    headings = table.headings([QUANTITIES[name].si for name in ROLES])
    by_role: dict[str, list[Heading]] = defaultdict(list)
    for heading in headings:
        by_role[_role(heading)].append(heading)
    for role in ROLES:  # a column whose unit does not fit the quantity is excluded, for example the voltage of a force sensor
        by_role[role] = [one for one in by_role[role] if unit_size(one.unit, QUANTITIES[role].si)] or by_role[role]
    wanted = "deflection" if over == "compression" else over or ("velocity" if by_role["velocity"] else "deflection")
    known, forces = by_role[wanted], by_role["force"]
    log = wanted == "velocity" and not known
    if log and not all(len(by_role[role]) == 1 for role in LOG):
        roles = {one.column: role for role in ROLES for one in by_role[role]}
        each = [f"{columns_in_words([one])} is {roles.get(one.column, 'not read')}" for one in headings]
        missing = [role for role in LOG if not by_role[role]] or [f"only one of {role}" for role in LOG if len(by_role[role]) > 1]
        raise InputError(
            f"has the columns {list_names(one.name for one in headings)}, but needs either velocity and force, or "
            "time, displacement and force, with units and for one damper setting. These columns were recognised: "
            f"{', '.join(each)}; columns that are still needed: {list_names(missing)}"
        )
    if log:
        known = by_role["deflection"]
    if not known and any(by_role[one] for one in ARGUMENTS):
        raise InputError(
            f"has the columns {list_names(one.name for one in headings)}; the columns {over or wanted} and force are needed"
        )
    sheet = sorted(one.direction for one in forces) == [-1, 1]
    told = {"deflection", "compression"} if over == "compression" else SIGN_HEADINGS[wanted]
    undirected = not sheet and not any(one.direction or told & one.words for one in (*known, *forces))
    asked = next((one for one in (*known, *headings) if one not in forces), headings[0])
    question = InputError(
        f"column {asked.column} is called {short_repr(asked.text)}, which does not state the positive direction; add "
        f"compression or extension to the heading, whichever is positive (in Roadproof, {wanted} is positive in "
        "extension)"
    )
    if undirected and not log and not (over == "compression" and known):
        raise question
    known = [one for one in known if one.direction or told & one.words] or known
    if len(known) != 1 or len(forces) != 1 + sheet:
        columns = list_names(one.name for one in headings)
        raise InputError(
            f"has the columns {columns}, but exactly two columns are needed; give only {over or wanted} and force, at "
            "one setting of the component"
        )
    used = [known[0], *sorted(forces, key=lambda one: one.direction)]
    numbers = table.numbers([one.column - 1 for one in used])[0]
    x, *values = (numbers * [used[0].scale("deflection" if log else wanted), *(one.scale("force") for one in used[1:])]).T
    clock = by_role["time"] if log else []
    notes = left_out_words(headings, [one.column for one in (*used, *clock)])
    if log:
        x, values[0], said = velocity_of(table.seconds(clock[0]), x, values[0])
        notes += [said] if used[0].direction or used[1].direction else [said, "displacement counts as positive in extension"]
    if sheet:
        return dict(zip((wanted, "force"), _of_sheet(x, *values), strict=True)) | _note(notes)
    if undirected and not log and numbers.min() < 0:
        raise question
    # The heading for the compression of a stop may contain additional words, as in "rebound stop compression". A heading
    # without a direction also means compression.
    named = -1 if over == "compression" and (undirected or "compression" in used[0].words) else used[0].direction
    towards = named or int(wanted == "deflection" and wanted in used[0].words) or used[1].direction or 1
    x, force = towards * x, (named or used[1].direction or 1) * values[0]
    if (np.diff(x) <= 0).any() and (np.diff(x) >= 0).any():
        turn, about = _dissipation_signs(x, force, *used) if wanted == "velocity" else ((1.0, 1.0), [])
        loop = mean_of_loop(turn[0] * x, turn[1] * force, QUANTITIES[wanted].si, at_rest=wanted == "velocity")
        if loop is not None:
            x, force, said = loop
            notes += [*about, said]
    order = np.argsort(x, kind="stable")
    # A table that contains a part of a hysteresis loop is monotonic neither in its argument nor in its force
    if (np.diff(x) <= 0).all() or (np.diff(force[order]) >= 0).all():
        x, force = x[order], force[order]
    different = np.append(True, (np.diff(x) != 0) | (np.diff(force) != 0))
    x, force = x[different], force[different]
    if over == "compression":
        wanted, x, force = over, -x[::-1], -force[::-1]
    return {wanted: (x + 0.0).tolist(), "force": (force + 0.0).tolist()} | _note(notes)  # adding 0.0 turns -0.0 into 0.0


def _note(remarks: Sequence[str]) -> dict[str, str]:
    return {"note": "; ".join(remarks)} if remarks else {}


def _dissipation_signs(velocity: Array, force: Array, motion: Heading, load: Heading) -> tuple[tuple[float, float], list[str]]:
    """Returns the signs of velocity and force with which a damper dissipates energy, and a remark if a sign is changed.

    Args:
        velocity: velocities [m/s], shape (n,).
        force: forces [N], shape (n,).
        motion: heading of the column with velocity or displacement.
        load: heading of the column with force.

    Raises:
        InputError: the headings state signs of velocity and force with which the damper would supply energy.
    """
    if (power := dissipation(velocity, force)) > 0:
        return (1.0, 1.0), []
    found = f"the force falls as velocity rises (mean power {rough(power)} W), but a damper dissipates energy"
    if motion.direction and load.direction:
        raise InputError(
            f"{found}; correct the direction that is stated in the heading of column {motion.column} or {load.column}"
        )
    what, signs = ("velocity", (-1.0, 1.0)) if load.direction else ("force", (1.0, -1.0))
    return signs, [f"{found}, so the sign of the {what} is turned"]


def _of_ratio(text: str) -> dict[str, Any]:
    """Returns a table of a motion ratio as a function of travel in SI units, positive in extension."""
    table = find_table(text, "give a .csv file with a header such as deflection [mm], ratio")
    headings = table.headings([QUANTITIES["deflection"].si])
    ratios = [one for one in headings if RATIO in one.words]
    travels = [one for one in headings if one.direction or "deflection" in one.words]
    if len(ratios) != 1 or len(travels) != 1:
        raise InputError(
            f"has the columns {list_names(one.name for one in headings)}; it must have one column called ratio, and "
            "one called deflection (positive in extension) or compression"
        )
    numbers = table.numbers([one.column - 1 for one in (*travels, *ratios)])[0]
    x = (travels[0].direction or 1) * travels[0].scale("deflection") * numbers[:, 0]
    order = np.argsort(x, kind="stable")
    return {"deflection": x[order].tolist(), RATIO: numbers[order, 1].tolist()}


def _role(heading: Heading) -> str:
    """Returns the quantity of a column, a key of `ROLES`, from the words or unit of the heading; empty if `ROLES` does not
    contain the quantity.
    """
    for role, words in ROLES.items():
        if heading.words & words:
            return role
    by_unit = next((role for role in ROLES if unit_size(heading.unit, QUANTITIES[role].si)), "")
    return by_unit or ("deflection" if heading.direction and not heading.unit else "")


def _of_sheet(speed: Array, compression: Array, rebound: Array) -> tuple[list[float], list[float]]:
    """Returns the velocities and forces in the data sheet of a damper dynamometer."""
    if (speed < 0).any():
        raise InputError(
            "has a speed below 0; give speeds of 0 or more, and for each speed the forces in compression and in rebound"
        )
    order = np.argsort(speed, kind="stable")
    v, *forces = (one[order] for one in (speed, compression, rebound))
    # Some data sheets give compression forces as negative numbers, others as positive numbers
    pushing, pulling = (np.sign(one.sum()) * one for one in forces)
    gas = np.where(v == 0, np.abs(pushing - pulling) > GAS * pulling.max(), np.minimum(pushing, pulling) < 0)
    for i in np.flatnonzero(gas)[:1]:
        a, b = (one[i] for one in forces)
        raise InputError(
            f"has {a:g} N in compression and {b:g} N in rebound at {v[i]:g} m/s, probably because of a gas charge; "
            "subtract the gas force from both columns, because it belongs to the preload of the spring"
        )
    v, pushing, pulling = (one[v > 0] for one in (v, pushing, pulling))
    return [*(-v[::-1]).tolist(), 0.0, *v.tolist()], [*(-pushing[::-1]).tolist(), 0.0, *pulling.tolist()]


def _dpr_columns(text: str) -> str:
    """Returns the table of a damper property file with headings, and the line number of each row in the file."""
    text = re.sub(r"[$!].*", "", text)
    # Number of lines of text before each block of the file
    before = {block[1].upper(): text[: block.start(2)].count("\n") for block in BLOCK.finditer(text)}
    blocks = {block[1].upper(): block[2] for block in BLOCK.finditer(text)}
    for name in ("UNITS", "CURVE"):
        if name not in blocks:
            raise InputError(
                f"has no block [{name}], but a damper property file must have [UNITS] and [CURVE]; give the whole file"
            )
    units = {key.upper(): unit.strip() for key, unit in re.findall(r"""(\w+)\s*=\s*['"]?([^'"\n]+)""", blocks["UNITS"])}
    if below := re.search(r"\{(.*?)\}\s*(.*)", blocks["UNITS"]):  # the units may also be written as a table
        units |= dict(zip(below[1].upper().split(), below[2].replace("'", " ").split(), strict=False))
    for key, name in (("LENGTH", "distance"), ("FORCE", "force"), ("TIME", "time")):
        if unit_size(units.get(key, ""), QUANTITIES[name].si) is None:
            found = f"has {key} = {short_repr(units[key])}" if key in units else f"has no {key}"
            raise InputError(f"[UNITS] {found}; give one of {list_names(QUANTITIES[name].units)}")
    heads = HEAD.findall(blocks["CURVE"])
    if len(heads) != 1:
        raise InputError(
            f"has {len(heads)} tables in [CURVE]; only one table is allowed; give one table with the heading {{ vel force }}"
        )
    names = re.sub(r"<[^>]*>", "", heads[0]).lower().split()
    if names not in (["vel", "force"], ["velocity", "force"]):
        raise InputError(
            f"has a table of {', '.join(names) or 'nothing'} in [CURVE]; give a table with the columns vel and force"
        )
    headings = f"velocity [{units['LENGTH']}/{units['TIME']}]\tforce [{units['FORCE']}]"
    return "\n" * (before["CURVE"] - 1) + headings + "\n" + HEAD.sub("", blocks["CURVE"])
