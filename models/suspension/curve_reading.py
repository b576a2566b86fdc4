"""`[curves]` of a vehicle file: tables of a damper's force over velocity, or a spring's over deflection, checked and thinned."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_keys, is_finite, number_within
from models.common.errors import InputError, error_in, listing, quoted
from models.common.units import in_unit
from models.suspension.curve import ForceCurve, slope_at_rest
from models.suspension.curve_lines import lines_from_rest, slopes_at_rest, thinned
from models.suspension.surface import ForceSurface, surface_of

FRICTION_ERROR = 0.02  # largest distance of the lines from the smooth curve, over the friction force
FRICTION_ENDS = 3.0  # velocity over v0 from which the friction is constant
FRICTION_POINTS = 601  # points of the smooth curve, of which the lines take some; the error between points is 1e-5


def friction_points(force: float, velocity: float) -> tuple[Array, Array]:
    """Returns points of a friction F tanh(v / v0), with an error of at most `FRICTION_ERROR` F, shapes (k,).

    Args:
        force: F [N].
        velocity: v0 [m/s].
    """
    v = np.linspace(0.0, FRICTION_ENDS, FRICTION_POINTS)
    smooth = np.append(np.tanh(v[:-1]), 1.0)
    indices = thinned(v, smooth, FRICTION_ERROR - 1e-4)
    half = np.append(v[indices], 2 * FRICTION_ENDS), np.append(smooth[indices], 1.0)
    v, smooth = (np.concatenate([-part[:0:-1], part]) for part in half)
    return velocity * v, force * smooth


MOST_POINTS = 20_000  # of a table
MOST_LINES = 24  # of a curve without its friction; each is an actuator, and costs 2 % of a quarter-car's time step
AT_REST = 2  # more lines of a thinned curve, which keep its slopes next to rest
ERRORS = (0.005, 0.01, 0.02)  # over a curve's largest force, if its table has more lines than that: the first with few lines
SMALLEST_ERROR, LARGEST_ERROR = 1e-6, 0.05
ROUNDING = 1e-9  # of a range
CLOSEST = 1e-9  # of a range, between points; nearer, rounding would decide
SMALLEST_REACH, SMALLEST_FORCE = 1e-6, 1e-6  # m or m/s, and N; less is a mistake
UNLOADED = 0.01  # of a spring's largest pull: a table that carries less has its signs reversed
MOST_SLOPE, MOST_PRELOAD = 1e12, 1e7  # N/m or N s/m, and N
SMALLEST_FRICTION, LARGEST_FRICTION = 1e-3, 1e5  # N
SMALLEST_CREEP, LARGEST_CREEP = 1e-4, 1.0  # m/s


@dataclass(frozen=True)
class Argument:
    """Argument of a curve.

    Attributes:
        name: key of the argument.
        unit: SI unit.
        largest: largest allowed value; larger ones are in another unit.
        small: the likely wrong unit.
        slope: SI unit of force over the argument.
    """

    name: str
    unit: str
    largest: float
    small: str
    slope: str


VELOCITY = Argument("velocity", "m/s", 50.0, "mm/s", "N s/m")
DEFLECTION = Argument("deflection", "m", 5.0, "mm", "N/m")
COMPRESSION = "compression"
FRICTION = ("friction", "friction_velocity")
UNITS = {  # of the keys of tables; lists hold numbers in these units, too
    "velocity": "m/s", "deflection": "m", "compression": "m", "force": "N", "ratio": "1", "fit_error": "1", "preload": "N",
    "friction": "N", "friction_velocity": "m/s",
}  # fmt: skip


def read_curves(
    section: Mapping[str, Any], parameters: Mapping[str, Argument], load: Callable[[str], float | None] = lambda name: None
) -> dict[str, ForceCurve]:
    """Returns the curves of a vehicle, by the parameter that each replaces.

    Args:
        section: the section, with tables instead of files.
        parameters: parameters that a curve can replace, each with the curve's argument.
        load: parameter -> static load of its spring [N], or None if it is unknown.

    Raises:
        InputError: an entry is not a curve, or not one that a suspension can have.
    """
    curves = {}
    for name, entry in section.items():
        if name not in parameters:
            raise InputError(
                f"[curves] {name!r} is not a stiffness or damping of a suspension; this vehicle has {listing(parameters)}"
            )
        with error_in(f"[curves] {name}:"):
            tables = [one for one in (entry if isinstance(entry, list) else [entry]) if isinstance(one, Mapping)]
            surface = parameters[name] is VELOCITY and any("deflection" in one for one in tables)
            if surface and (isinstance(entry, list) or set(FRICTION) & set(entry)):
                raise InputError("a position-dependent damper cannot have friction, or other elements next to it; give it alone")
            curves[name] = _surface(tables[0]) if surface else curve_of(entry, parameters[name], lambda name=name: load(name))
    return curves


def curve_keys(over: Argument) -> tuple[str, ...]:
    """Returns the keys of a curve over this argument."""
    return (*_names(over), "force", "file", "fit_error", *(FRICTION if over is VELOCITY else ("preload",)), "note")


def in_si(table: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a table with numbers in SI units instead of numbers with units, and lists instead of the tuples of a log.

    Raises:
        InputError: a unit is unknown, or of another dimension than its key.
    """

    def converted(value: Any, unit: str, key: str) -> Any:
        return [converted(one, unit, key) for one in value] if isinstance(value, list | tuple) else in_unit(value, unit, key)

    return {key: converted(value, UNITS[key], key) if key in UNITS else value for key, value in table.items()}


def _names(over: Argument) -> tuple[str, ...]:
    """Returns the possible names of a table's argument; a spring's or a stop's deflection is minus its compression."""
    return (over.name, COMPRESSION) if over is DEFLECTION else (over.name,)


def curve_of(entry: Any, over: Argument, load: Callable[[], float | None] = lambda: None) -> ForceCurve:
    """Returns a curve from its table, or from a list of tables and slopes that add up.

    Args:
        load: function that returns the static load of the spring [N], or None if it is unknown.

    Raises:
        InputError: the entry is not a curve, or not one that a suspension can have.
    """
    entries = [in_unit(one, over.slope, "a slope") for one in entry] if isinstance(entry, list) else [entry]
    slopes = [number_within("a slope", one, 0.0, MOST_SLOPE) for one in entries if is_finite(one) and isinstance(entry, list)]
    tables = [_table(one, over) for one in entries if not is_finite(one) or not isinstance(entry, list)]
    if not tables:
        raise InputError(f"has {len(slopes)} numbers and no table; give their sum in [parameters]")
    # The one with preload = true carries what the others leave.
    tables.sort(key=lambda one: one.get("preload") is True)
    parts: list[tuple[Array, Array, float]] = []
    for one in tables:
        preload = one.get("preload", False)
        if preload is True:
            whole = load()
            if whole is None or any(each is not one and each.get("preload") is True for each in tables):
                raise InputError("the load of this spring is unknown; give preload in N, and true for one table at most")
            preload = whole + sum(at_rest for _, _, at_rest in parts)
        elif preload is not False:
            number_within("preload", preload, SMALLEST_FORCE, MOST_PRELOAD, "N")
        parts.append(_part(one, over, preload, alone=len(entries) == 1))
    x, force, _ = parts[0]
    if len(entries) > 1:
        x = _knots([x for x, _, _ in parts])
        force = sum(slopes) * x + sum(ForceCurve(*part[:2], 0.0, "")(x) for part in parts)
        force = np.where(x == 0, 0.0, force)
    errors = [one["fit_error"] for one in tables if "fit_error" in one]
    ends, forces, words = as_lines(x, force, min(errors) if len(errors) > 1 else errors[0] if errors else None)
    words = f"sum of {len(entries)} elements: {words}" if len(entries) > 1 else words
    curve = _checked(ForceCurve(ends, forces, slope_at_rest(ends, forces), words), over)
    if (error := float(np.abs(np.interp(x, ends, forces) - force).max())) > ROUNDING * curve.range:
        curve = replace(curve, whole=ForceCurve(x, force, slope_at_rest(x, force), ""), error=error)
    for one in tables:
        curve = _with_friction(curve, one) if set(FRICTION) & set(one) else curve
    note = "; ".join(str(one["note"]) for one in tables if "note" in one)
    words = f"{curve.words}; {note}" if note else curve.words
    return replace(curve, words=words, note=note, at_rest=sum(at_rest for _, _, at_rest in parts))


def _table(entry: Any, over: Argument) -> Mapping[str, Any]:
    """Returns the table of a curve, its keys checked."""
    what = f'{{ {over.name} = [...], force = [...] }}, or {{ file = "NAME.csv" }}'
    if not isinstance(entry, Mapping):
        raise InputError(f"{quoted(entry)} is not a curve; give {what}")
    if "file" in entry:
        raise InputError("names a file, which is read for a vehicle file alone, not for text; give its table")
    check_keys("", entry, curve_keys(over))
    if len(found := [key for key in _names(over) if key in entry]) > 1:
        raise InputError(f"has {listing(found)}; omit one of them")
    for key in (found[0] if found else over.name, "force"):
        if key not in entry:
            raise InputError(f"{key} is missing; give {what}")
    return in_si(entry)


def _part(entry: Mapping[str, Any], over: Argument, preload: float, alone: bool) -> tuple[Array, Array, float]:
    """Returns the points of one table relative to rest, and its force at rest.

    Args:
        preload: load that it carries at rest, where it then is [N]; 0 if it is at rest at 0.
        alone: False for one of several tables, which may be a stop on one side of rest.
    """
    x, force = points(entry, over)
    if preload:
        x = x - _carrying(x, force, preload)
    if not alone and not x[0] < 0 < x[-1] and abs(force[i := 0 if x[0] >= 0 else -1]) <= ROUNDING * np.abs(force).max():
        side = np.array([-x[-1], *[0.0] * bool(x[0] > 0)]) if i == 0 else np.array([*[0.0] * bool(x[-1] < 0), -x[0]])
        parts = ((side, x), (0 * side, force))
        x, force = (np.concatenate(part if i == 0 else part[::-1]) for part in parts)
    _check_both_sides(x, over)
    return _from_rest(x, force, over)


def _carrying(x: Array, force: Array, load: float) -> float:
    """Returns the deflection at which a spring carries a load."""
    left = force + load
    for i in np.flatnonzero((left[:-1] <= 0) & (left[1:] >= 0))[:1].tolist():
        return float(np.interp(0.0, left[i : i + 2], x[i : i + 2]))
    low, high = (max(0.0, float(each)) for each in (-force.max(), -force.min()))
    do = "extend the table, or correct preload"
    if high < UNLOADED * force.max():
        do = "if its deflections are positive in compression, call them compression"
    raise InputError(f"its table carries {low:.6g} to {high:.6g} N, but the static load is {load:.6g} N; {do}")


def _knots(parts: Sequence[Array]) -> Array:
    """Returns the points of several curves, ascending, without those that rounding alone keeps apart; rest stays."""
    x = np.unique(np.concatenate(parts))
    close = 2 * CLOSEST * (x[-1] - x[0])
    x = x[(np.abs(x) > close) | (x == 0)]
    return x[np.append(True, np.diff(x) > close)]


def points(entry: Mapping[str, Any], over: Argument, of: str = "force") -> tuple[Array, Array]:
    """Returns argument and force of a table, positive in extension; or argument and another quantity.

    Raises:
        InputError: a point is not a number, or the argument does not ascend, or is in a wrong unit.
    """
    if COMPRESSION in entry and over.name != COMPRESSION:
        x, force = points(entry, replace(over, name=COMPRESSION), of)
        return -x[::-1], (-force if of == "force" else force)[::-1]
    x, force = _ascending(entry[over.name], over), _points(entry[of], of)
    if len(x) != len(force):
        raise InputError(f"has {len(x)} values of {over.name} and {len(force)} of {of}; give as many")
    return x, force


def _ascending(given: Any, over: Argument) -> Array:
    """Returns the ascending values of an argument."""
    x = _points(given, over.name)
    for i in np.flatnonzero(np.diff(x) < CLOSEST * np.ptp(x))[:1].tolist():
        do = f"sort the points by {over.name}, each once" if x[i] >= x[i + 1] else "omit one of them"
        raise InputError(f"{over.name} goes from {x[i]:g} to {x[i + 1]:g} {over.unit} at point {i + 2}; {do}")
    if max(-x[0], x[-1]) > over.largest:
        raise InputError(
            f"{over.name} goes from {x[0]:g} to {x[-1]:g}, and at most {over.largest:g} {over.unit} is allowed; "
            f"give {over.unit}, not {over.small}"
        )
    return x


def _points(given: Any, name: str) -> Array:
    """Returns a list of finite numbers as an array."""
    if not isinstance(given, list) or len(given) < 2:
        count = f"{len(given)} point(s)" if isinstance(given, list) else quoted(given)
        raise InputError(f"{name} has {count}; give a list of at least two{', [N]' * (name == 'force')}")
    if len(given) > MOST_POINTS:
        raise InputError(f"{name} has {len(given)} points; at most {MOST_POINTS} are read: thin the table")
    for i, value in enumerate(given, 1):
        if not is_finite(value) or not abs(value) <= 1e9:
            raise InputError(f"{name} has {quoted(value)} as point {i}; give finite numbers, at most 1e9")
    return np.array(given, dtype=float)


def _check_both_sides(x: Array, over: Argument) -> None:
    if not x[0] < 0 < x[-1]:
        free = ", or preload = true for a table that begins at the free length" if over is DEFLECTION else ""
        raise InputError(
            f"{over.name} goes from {x[0] + 0.0:g} to {x[-1] + 0.0:g} {over.unit}; give both sides of rest: below 0 where the "
            f"suspension is compressed, above 0 where it extends{free}"
        )
    if min(-x[0], x[-1]) < SMALLEST_REACH:
        raise InputError(
            f"{over.name} goes from {x[0]:g} to {x[-1]:g} {over.unit}; give at least {SMALLEST_REACH:g} on both sides"
        )


def _from_rest(x: Array, force: Array, over: Argument) -> tuple[Array, Array, float]:
    """Returns the points with rest among them, the forces without that at rest, a spring's weight, and the force at rest."""
    x = np.where(np.abs(x) < CLOSEST * (x[-1] - x[0]), 0.0, x)
    at_rest, largest = float(np.interp(0.0, x, force)), float(np.abs(force).max())
    if over is VELOCITY and abs(at_rest) > ROUNDING * largest:
        raise InputError(
            f"its force at rest is {at_rest:g} N, but a damper's must be 0; subtract the force of its gas, which is "
            "part of the spring's preload"
        )
    force = force - at_rest
    if not np.abs(force).max() >= SMALLEST_FORCE:
        raise InputError(
            f"the force differs by at most {np.abs(force).max():g} N from the force at rest; give at least {SMALLEST_FORCE:g} N"
        )
    if 0.0 not in x:
        i = int(np.searchsorted(x, 0.0))
        x, force = np.insert(x, i, 0.0), np.insert(force, i, 0.0)
    return x, np.where(x == 0, 0.0, force), at_rest


def as_lines(x: Array, force: Array, fit_error: Any) -> tuple[Array, Array, str]:
    """Returns the curve in as few straight lines as will do, with the slopes of its points at rest, and its description."""
    if fit_error is not None:
        number_within("fit_error", fit_error, SMALLEST_ERROR, LARGEST_ERROR, more=", a share of its largest force")
    largest = float(np.abs(force).max())
    indices = thinned(x, force, ROUNDING * largest / 1e3)
    words = f"{len(x)} points"
    if fit_error is not None or len(indices) > MOST_LINES + 1:
        error, ends, forces = 0.0, x, force
        for error in ERRORS if fit_error is None else (float(fit_error),):
            ends, forces = lines_from_rest(x, force, slopes_at_rest(x, force, error * largest), error * largest)
            if len(ends) <= MOST_LINES + AT_REST + 1:
                break
        else:
            raise InputError(
                f"needs {len(ends) - 1} straight lines to be within {100 * error:g} % of its largest force, and at most "
                f"{MOST_LINES + AT_REST} are allowed; smooth the table, or give fit_error, up to {LARGEST_ERROR:g}"
            )
        words += f" replaced by {len(ends) - 1} straight lines, with errors within {100 * error:g} % of {largest:.4g} N"
        return ends, forces, words
    return x[indices], force[indices], words


def _checked(curve: ForceCurve, over: Argument) -> ForceCurve:
    """Returns the curve if a suspension can have it."""
    if over is VELOCITY:
        for x, force in zip(curve.x.tolist(), curve.force.tolist(), strict=True):
            if x * force < 0:
                raise InputError(
                    f"its force at {x:g} m/s is {force:g} N: that feeds energy in, where a damper takes it; give forces of the "
                    "velocity's sign, both positive where the suspension extends"
                )
    elif min(float(curve(np.array([s * 1e-12]))[0]) * s for s in (-1, 1)) <= 0 or curve.slope <= 0:
        raise InputError(
            "its slope at rest is not above 0, and so it holds nothing up; give forces that rise with deflection, both positive "
            "where the suspension stretches, or add the spring to a stop, as in [22e3, { ... }]"
        )
    for end, side in ((0, "below its first point"), (-1, "beyond its last point")):
        if curve.slopes[end] < 0:
            raise InputError(
                f"its force falls {side} by {-curve.slopes[end]:g} N per {over.unit}, as the last slope continues; give a last "
                "point that ends flat or rising"
            )
    return curve


def _surface(entry: Mapping[str, Any]) -> ForceSurface:
    """Returns a damper's force over velocity and deflection from its table."""
    entry, over = in_si(entry), (VELOCITY, DEFLECTION)
    names = [*(one.name for one in over), "force"]
    check_keys("", entry, names)
    if absent := [name for name in names if name not in entry]:
        what = "{ velocity = [...], deflection = [...], force = [[...], ...] }, a list of forces for each velocity"
        raise InputError(f"{absent[0]} is missing; give {what}")
    v, d = (_ascending(entry[one.name], one) for one in over)
    rows = entry["force"] if isinstance(entry["force"], list) else []
    widths = sorted({len(row) if isinstance(row, list) else 1 for row in rows})
    if len(rows) != len(v) or widths != [len(d)]:
        raise InputError(
            f"force has {len(rows)} lists, of {listing(map(str, widths)) or 0} numbers; give {len(v)} lists, one for each "
            f"velocity, of {len(d)} numbers, one for each deflection"
        )
    table = np.array([_points(row, "force") for row in rows])
    _check_both_sides(v, VELOCITY)
    if not d[0] <= 0 <= d[-1]:
        raise InputError(f"deflection goes from {d[0]:g} to {d[-1]:g} m; give a range with equilibrium, deflection 0, in it")
    columns = []
    for at, column in zip(d, table.T, strict=True):
        with error_in(f"at deflection {at:g} m:"):
            x, force, _ = _from_rest(v, column, VELOCITY)
            columns.append(_checked(ForceCurve(x, force, slope_at_rest(x, force), ""), VELOCITY))
    words = f"{len(v)} velocities by {len(d)} deflections, at most {np.abs(table).max():g} N"
    return surface_of(columns[0].x, d, np.stack([one.force for one in columns], axis=1), words)


def _with_friction(curve: ForceCurve, entry: Mapping[str, Any]) -> ForceCurve:
    """Returns the curve with a friction F tanh(v / v0) added, which leaves the slope of linear analysis unchanged."""
    limits = {"friction": (SMALLEST_FRICTION, LARGEST_FRICTION), "friction_velocity": (SMALLEST_CREEP, LARGEST_CREEP)}
    for key, (low, high) in limits.items():
        if key not in entry:
            raise InputError(
                f"{key} is missing; a friction is F tanh(v / v0) with friction, F, in N and friction_velocity, v0, in m/s"
            )
        value = entry[key]
        unit = "N" if key == "friction" else "m/s"
        number_within(key, value, low, high, unit, ": a friction is F tanh(v / v0) with friction, F, and friction_velocity, v0")
    v, force = friction_points(entry["friction"], entry["friction_velocity"])
    x = np.unique(np.concatenate([curve.x, v]))
    straight = np.interp(np.clip(x, v[0], v[-1]), v, force)
    words = (
        f"{curve.words}, and friction of {entry['friction']:g} N tanh(v / {entry['friction_velocity']:g} m/s) as "
        f"{len(v) - 1} straight lines, within {100 * FRICTION_ERROR:g} % of it"
    )
    return ForceCurve(x, curve(x) + straight, curve.slope, words)
