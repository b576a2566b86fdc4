"""`[curves]` of a vehicle file: tables of damper force against velocity, or of spring force against deflection.

The tables in `[curves]` are checked, and approximated by tables with fewer points.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, ClassVar

import numpy as np

from models.characteristics.curve import ForceCurve, slope_at_rest
from models.characteristics.curve_lines import lines_from_rest, point_indices, slopes_at_rest
from models.characteristics.surface import ForceSurface, surface_of
from models.common.arrays import Array
from models.common.errors import InputError, error_in, list_names
from models.common.schema import HERE, SI, ListedValues, Section, Text, read

FRICTION_ERROR = 0.02  # largest error of the straight segments that replace the friction force, relative to this force
FRICTION_ENDS = 3.0  # above this velocity, relative to the velocity v0 of the friction, the friction force is constant
# Number of points that represent the smooth friction function. Some of these points become ends of straight segments; the
# interpolation error between two points is 1e-5
FRICTION_POINTS = 601


def friction_points(force: float, velocity: float) -> tuple[Array, Array]:
    """Returns points of the friction force F tanh(v / v0).

    Straight segments between the points differ from the friction force by at most `FRICTION_ERROR` times F.

    Args:
        force: F [N].
        velocity: v0 [m/s].

    Returns:
        Velocity [m/s] and force [N] of each point, shapes (k,).
    """
    v = np.linspace(0.0, FRICTION_ENDS, FRICTION_POINTS)
    smooth = np.append(np.tanh(v[:-1]), 1.0)
    indices = point_indices(v, smooth, FRICTION_ERROR - 1e-4)
    half = np.append(v[indices], 2 * FRICTION_ENDS), np.append(smooth[indices], 1.0)
    v, smooth = (np.concatenate([-part[:0:-1], part]) for part in half)
    return velocity * v, force * smooth


MOST_POINTS = 20_000  # largest allowed number of points in a table
# Largest number of segments of a characteristic without friction. Each segment is a MuJoCo actuator, and makes a time step of a
# quarter-car 2 % slower
MOST_LINES = 24
AT_REST = 2  # an approximation has this number of additional segments, which keep the slopes of the table at argument 0
# Errors that are allowed when a table with more than `MOST_LINES` segments is approximated, relative to the largest force. The
# first of these errors that gives few enough segments is used.
ERRORS = (0.005, 0.01, 0.02)
ROUNDING = 1e-9  # force differences below this share of the largest force count as rounding errors
# Smallest distance between two points, relative to the range; at smaller distances, rounding errors would dominate
CLOSEST = 1e-9
# Smallest range of a table's argument [m or m/s] and smallest force [N]; a table with smaller values is probably a mistake
SMALLEST_REACH, SMALLEST_FORCE = 1e-6, 1e-6
# If a spring's table carries less than this share of the static load, the signs of the table are probably reversed
LEAST_PULL = 0.01
# Largest slope of a characteristic [N/m or N s/m]; largest error of an approximation relative to the largest force
MOST_SLOPE, LARGEST_ERROR = 1e12, 0.05
FRICTION = ("friction", "friction_velocity")
ALONE = "is not allowed: a position-dependent damper cannot be combined with friction or other elements; give it alone"


@dataclass(frozen=True)
class Argument(ListedValues):
    """Argument of a characteristic, such as the velocity; a file gives the values of the argument as an ascending list.

    Attributes:
        name: key of the list in the file, such as "velocity".
        largest: largest allowed value; a larger value probably has a wrong unit.
        small: smaller unit, such as mm, in which a value above `largest` is probably given, for messages.
        slope: SI unit of a slope, the unit of force divided by the unit of the argument.
    """

    name: str = ""
    largest: float = 0.0
    small: str = ""
    slope: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> tuple[float, ...]:
        """Returns the values of the velocity, deflection or compression, after checking that these values ascend."""
        x = np.array(super().read(value, context))
        for i in np.flatnonzero(np.diff(x) < CLOSEST * np.ptp(x))[:1].tolist():
            do = f"sort the points by {self.name}, and give each value once" if x[i] >= x[i + 1] else "omit one of them"
            raise InputError(f"{HERE} goes from {x[i]:g} to {x[i + 1]:g} {self.unit} at point {i + 2}; {do}")
        if max(-x[0], x[-1]) > self.largest:
            raise InputError(
                f"{HERE} goes from {x[0]:g} to {x[-1]:g}, but at most {self.largest:g} {self.unit} is allowed; check "
                f"that the values are in {self.unit}, not in {self.small}"
            )
        return tuple(x.tolist())


VELOCITY = Argument(
    "velocities, positive in extension", SI("m/s", "", -1e9, 1e9), "", 2, MOST_POINTS, "velocity", 50.0, "mm/s", "N s/m"
)
DEFLECTION = Argument(
    "deflections, positive in extension", SI("m", "", -1e9, 1e9), "", 2, MOST_POINTS, "deflection", 5.0, "mm", "N/m"
)
COMPRESSION = replace(DEFLECTION, name="compression", meaning="compressions, instead of deflections; forces are positive, too")
FORCE = ListedValues("force at each point, positive in extension", SI("N", "", -1e9, 1e9), "", 2, MOST_POINTS)
Values = tuple[float, ...]


@dataclass(frozen=True)
class TableSection(Section):
    """Section with a table of a quantity against its argument (such as force against velocity), or with the name of a file that
    contains the table.
    """

    arguments: ClassVar[tuple[str, ...]] = ("velocity",)
    of: ClassVar[str] = "force"

    file: Annotated[str, Text("file with the table, such as `damper.csv`, instead of the table")] | None = None

    def __post_init__(self) -> None:
        given = [name for name in (*self.arguments, self.of) if getattr(self, name) is not None]
        if self.file is not None:
            raise InputError(
                "names a file, but a vehicle that is read from text cannot refer to files; give the table itself instead "
                "of the file"
            )
        if len(given) > 2:
            raise InputError(f"has {list_names(given[:-1])}; omit one of them")
        for key in (given[0] if given and given != [self.of] else self.arguments[0], self.of):
            if key not in given:
                what = f'{{ {self.arguments[0]} = [...], {self.of} = [...] }}, or {{ file = "NAME.csv" }}'
                raise InputError(f"{HERE}.{key} is missing; give {what}")
        x, values = (getattr(self, name) for name in given)
        if len(x) != len(values):
            raise InputError(
                f"has {len(x)} values of {given[0]} and {len(values)} of {self.of}; give one value of {self.of} for each "
                f"value of {given[0]}"
            )

    @property
    def points(self) -> tuple[Array, Array]:
        """Argument (velocity or deflection) and values of the table, shapes (n,), positive in extension."""
        x, values = (np.array(getattr(self, name)) for name in (*self.arguments, self.of) if getattr(self, name) is not None)
        return (x, values) if getattr(self, "compression", None) is None else (-x[::-1], -values[::-1])


@dataclass(frozen=True)
class CurveTable(TableSection):
    """Section with a table of the force at several points; the force is interpolated linearly between the points."""

    preload: ClassVar[Any] = False

    force: Annotated[Values, FORCE] | None = None
    fit_error: (
        Annotated[float, SI("1", "largest error of the straight lines, relative to the largest force", high=LARGEST_ERROR)] | None
    ) = None
    note: Annotated[str, Text("remark on the table, printed as a warning")] = ""


@dataclass(frozen=True)
class StopTableSection(CurveTable):
    """Section with the table of a bump stop's force."""

    arguments: ClassVar[tuple[str, ...]] = ("compression", "deflection")

    deflection: Annotated[Values, DEFLECTION] | None = None
    compression: Annotated[Values, COMPRESSION] | None = None


class Preload(SI):
    """Key for the load that a spring's table carries in equilibrium; the value `true` means the static load of the spring."""

    def read(self, value: Any, context: Mapping[str, Any]) -> Any:
        """Returns the load [N]; a value `true` or `false` is returned unchanged."""
        return value if isinstance(value, bool) else super().read(value, context)

    @property
    def json(self) -> Mapping[str, Any]:
        """The JSON schema of the load."""
        return {"anyOf": [super().json, {"type": "boolean"}]}


@dataclass(frozen=True)
class SpringTable(StopTableSection):
    """Force of a spring."""

    arguments: ClassVar[tuple[str, ...]] = ("deflection", "compression")

    preload: Annotated[Any, Preload("N", "load that the table carries at rest; true for the static load", 1e-6, 1e7)] = False


@dataclass(frozen=True)
class DamperTable(CurveTable):
    """Section with a table of a damper's force, to which a friction force F tanh(v / v0) can be added."""

    hints: ClassVar[Mapping[str, str]] = {"deflection": ALONE}

    velocity: Annotated[Values, VELOCITY] | None = None
    friction: Annotated[float, SI("N", "largest force F of the friction F tanh(v / v0)", 1e-3, 1e5)] | None = None
    friction_velocity: Annotated[float, SI("m/s", "velocity v0 of the friction F tanh(v / v0)", 1e-4, 1.0)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        absent = [name for name in FRICTION if getattr(self, name) is None]
        if len(absent) == 1:
            what = "the friction F tanh(v / v0) needs both friction, which is F in N, and friction_velocity, which is v0 in m/s"
            raise InputError(f"{HERE}.{absent[0]} is missing; {what}")


@dataclass(frozen=True)
class SurfaceTable(Section):
    """Section with a table of a damper's force against velocity and deflection."""

    hints: ClassVar[Mapping[str, str]] = dict.fromkeys(FRICTION, ALONE)

    velocity: Annotated[Values, VELOCITY]
    deflection: Annotated[Values, DEFLECTION]
    force: Annotated[
        tuple[Values, ...], ListedValues("a list of forces for each velocity, one for each deflection", FORCE, least=2)
    ]

    def __post_init__(self) -> None:
        widths = sorted({len(row) for row in self.force})
        if len(self.force) != len(self.velocity) or widths != [len(self.deflection)]:
            raise InputError(
                f"{HERE}.force has {len(self.force)} lists with {list_names(map(str, widths))} numbers; give "
                f"{len(self.velocity)} lists (one for each velocity), each with {len(self.deflection)} numbers (one "
                "for each deflection)"
            )


def read_curves(
    section: Mapping[str, Any], parameters: Mapping[str, Argument], load: Callable[[str], float | None] = lambda name: None
) -> dict[str, ForceCurve]:
    """Returns the characteristics of a vehicle, by name of the parameter that each characteristic replaces.

    Args:
        section: the section `[curves]`.
        parameters: parameters that a characteristic can replace, each with the variable (such as velocity) on which the
            characteristic depends.
        load: function that takes the name of a spring's parameter, and returns the static load of the spring [N]; None for an
            unknown load.

    Raises:
        InputError: an entry is not a characteristic, or the characteristic is not valid for a suspension.
    """
    curves = {}
    for name, entry in section.items():
        if name not in parameters:
            raise InputError(
                f"[curves] {name!r} is not a stiffness or damping of a suspension; this vehicle has {list_names(parameters)}"
            )
        where, over = f"[curves] {name}", parameters[name]
        positional = over is VELOCITY and isinstance(entry, Mapping) and "deflection" in entry
        curves[name] = _surface(where, entry) if positional else curve_of(where, entry, over, partial(load, name))
    return curves


def curve_of(where: str, entry: Any, over: Argument, load: Callable[[], float | None] = lambda: None) -> ForceCurve:
    """Returns a characteristic from its table, or from a list of tables and slopes whose forces are added.

    Args:
        where: place of the entry in the vehicle file, for messages.
        entry: the table, or the list of tables and slopes.
        over: argument of the characteristic.
        load: function that returns the static load of the spring [N], or None for an unknown load.

    Raises:
        InputError: the entry is not a characteristic, or the characteristic is not valid for a suspension.
    """
    slopes, tables = [], []
    for one in entry if isinstance(entry, list) else [entry]:
        if isinstance(one, Mapping) or one is entry:
            tables.append(read(where, DamperTable if over is VELOCITY else SpringTable, one))
        else:
            slopes.append(SI(over.slope, low=0.0, high=MOST_SLOPE).number(f"{where} a slope", one))
    # The table with `preload = true` is read last, because it carries the part of the load that the other tables do not carry
    tables.sort(key=lambda one: one.preload is True)
    with error_in(f"{where}:"):
        return _sum(slopes, tables, over, load)


def _sum(slopes: Sequence[float], tables: Sequence[Any], over: Argument, load: Callable[[], float | None]) -> ForceCurve:
    """Returns one characteristic whose force is the sum of the forces from all slopes and tables."""
    count = len(tables) + len(slopes)
    if not tables:
        raise InputError(
            f"has {count} numbers but no table, so they add up to a constant, not to a curve; give the sum of the "
            "numbers in [parameters] instead"
        )
    parts: list[tuple[Array, Array, float]] = []
    for one in tables:
        preload = one.preload
        if preload is True:
            whole = load()
            if whole is None or sum(each.preload is True for each in tables) > 1:
                raise InputError(
                    "preload = true needs a static load that is known and that only one table carries; give preload "
                    "in N instead, or give preload = true in only one table"
                )
            preload = whole + sum(at_rest for _, _, at_rest in parts)
        x, force = one.points
        parts.append(_part(x, force, over, preload, alone=count == 1))
    x, force, _ = parts[0]
    if count > 1:
        x = _knots([x for x, _, _ in parts])
        force = sum(slopes) * x + sum(ForceCurve(*part[:2], 0.0, "")(x) for part in parts)
        force = np.where(x == 0, 0.0, force)
    ends, forces, words = as_lines(x, force, min((one.fit_error for one in tables if one.fit_error is not None), default=None))
    words = f"sum of {count} elements: {words}" if count > 1 else words
    curve = _check_curve(ForceCurve(ends, forces, slope_at_rest(ends, forces), words), over)
    if (error := float(np.abs(np.interp(x, ends, forces) - force).max())) > ROUNDING * curve.range:
        curve = replace(curve, whole=ForceCurve(x, force, slope_at_rest(x, force), ""), error=error)
    for one in tables:
        if getattr(one, "friction", None) is not None:
            curve = _with_friction(curve, one.friction, one.friction_velocity)
    note = "; ".join(one.note for one in tables if one.note)
    words = f"{curve.words}; {note}" if note else curve.words
    return replace(curve, words=words, note=note, at_rest=sum(at_rest for _, _, at_rest in parts))


def _part(x: Array, force: Array, over: Argument, preload: float, alone: bool) -> tuple[Array, Array, float]:
    """Returns the points of a single table relative to equilibrium, and the force of the table in equilibrium.

    Args:
        x: deflections or velocities of the table [m or m/s], shape (n,).
        force: forces of the table [N], shape (n,).
        over: argument of the characteristic.
        preload: load that the spring of the table carries in equilibrium [N]; 0 if the equilibrium is at deflection 0 of the
            table.
        alone: False if the characteristic is a sum of several tables. In a sum, a table may belong to a stop that acts only on
            one side of equilibrium.
    """
    if preload:
        x = x - _deflection_under_load(x, force, preload)
    if not alone and not x[0] < 0 < x[-1] and abs(force[i := 0 if x[0] >= 0 else -1]) <= ROUNDING * np.abs(force).max():
        side = np.array([-x[-1], *[0.0] * bool(x[0] > 0)]) if i == 0 else np.array([*[0.0] * bool(x[-1] < 0), -x[0]])
        parts = ((side, x), (0 * side, force))
        x, force = (np.concatenate(part if i == 0 else part[::-1]) for part in parts)
    _check_both_sides(x, over)
    return _from_rest(x, force, over)


def _deflection_under_load(x: Array, force: Array, load: float) -> float:
    """Returns the deflection at which a spring carries a load."""
    left = force + load
    for i in np.flatnonzero((left[:-1] <= 0) & (left[1:] >= 0))[:1].tolist():
        return float(np.interp(0.0, left[i : i + 2], x[i : i + 2]))
    low, high = (max(0.0, float(each)) for each in (-force.max(), -force.min()))
    do = "extend the table, or correct preload"
    if high < LEAST_PULL * force.max():
        do = "if its deflections are positive in compression, call them compression"
    raise InputError(f"its table covers forces from {low:.6g} to {high:.6g} N, but the static load is {load:.6g} N; {do}")


def _knots(parts: Sequence[Array]) -> Array:
    """Returns the points of several characteristics in ascending order, without duplicates due to rounding.

    The point at 0 is never removed."""
    x = np.unique(np.concatenate(parts))
    close = 2 * CLOSEST * (x[-1] - x[0])
    x = x[(np.abs(x) > close) | (x == 0)]
    return x[np.append(True, np.diff(x) > close)]


def _check_both_sides(x: Array, over: Argument) -> None:
    if not x[0] < 0 < x[-1]:
        free = ", or preload = true for a table that begins at the free length" if over is DEFLECTION else ""
        raise InputError(
            f"{over.name} goes from {x[0] + 0.0:g} to {x[-1] + 0.0:g} {over.unit}, but both sides of equilibrium are "
            f"needed; give values below 0 for compression and above 0 for extension{free}"
        )
    if min(-x[0], x[-1]) < SMALLEST_REACH:
        raise InputError(
            f"{over.name} goes from {x[0]:g} to {x[-1]:g} {over.unit}, but it must reach at least {SMALLEST_REACH:g} "
            "on both sides of 0; extend the table"
        )


def _from_rest(x: Array, force: Array, over: Argument) -> tuple[Array, Array, float]:
    """Returns points that include the equilibrium, the force at each point minus the force in equilibrium, and the force in
    equilibrium.

    For a spring, the force in equilibrium is the weight that the spring carries. For a damper, the force in equilibrium must be
    0.
    """
    x = np.where(np.abs(x) < CLOSEST * (x[-1] - x[0]), 0.0, x)
    at_rest, largest = float(np.interp(0.0, x, force)), float(np.abs(force).max())
    if over is VELOCITY and abs(at_rest) > ROUNDING * largest:
        raise InputError(
            f"its force at rest is {at_rest:g} N, but a damper has no force at rest; subtract the gas force from the "
            "table, because it belongs to the preload of the spring"
        )
    force = force - at_rest
    if not np.abs(force).max() >= SMALLEST_FORCE:
        raise InputError(
            f"the force differs by at most {np.abs(force).max():g} N from the force at rest, which is too little; "
            f"give forces that differ by at least {SMALLEST_FORCE:g} N"
        )
    if 0.0 not in x:
        i = int(np.searchsorted(x, 0.0))
        x, force = np.insert(x, i, 0.0), np.insert(force, i, 0.0)
    return x, np.where(x == 0, 0.0, force), at_rest


def as_lines(x: Array, force: Array, fit_error: float | None) -> tuple[Array, Array, str]:
    """Approximates a characteristic by as few straight segments as possible.

    The slopes of the approximation next to 0 are the slopes that the points have there.

    Args:
        x: velocity or deflection of each point, ascending, shape (n,).
        force: force at each point [N], shape (n,).
        fit_error: largest allowed error as a share of the largest force; None for the default.

    Returns:
        Argument and force of the remaining points, shapes (k,), and a description of the approximation.
    """
    largest = float(np.abs(force).max())
    indices = point_indices(x, force, ROUNDING * largest / 1e3)
    words = f"{len(x)} points"
    if fit_error is not None or len(indices) > MOST_LINES + 1:
        error, ends, forces = 0.0, x, force
        for error in ERRORS if fit_error is None else (fit_error,):
            ends, forces = lines_from_rest(x, force, slopes_at_rest(x, force, error * largest), error * largest)
            if len(ends) <= MOST_LINES + AT_REST + 1:
                break
        else:
            raise InputError(
                f"needs {len(ends) - 1} straight lines to approximate its table within {100 * error:g} % of its "
                f"largest force, but at most {MOST_LINES + AT_REST} lines are allowed; smooth the table, or give a "
                f"larger fit_error, up to {LARGEST_ERROR:g}"
            )
        words += f" replaced by {len(ends) - 1} straight lines, with errors within {100 * error:g} % of {largest:.4g} N"
        return ends, forces, words
    return x[indices], force[indices], words


def _check_curve(curve: ForceCurve, over: Argument) -> ForceCurve:
    """Returns the characteristic if it is valid for a suspension; otherwise raises an InputError."""
    if over is VELOCITY:
        for x, force in zip(curve.x.tolist(), curve.force.tolist(), strict=True):
            if x * force < 0:
                raise InputError(
                    f"its force at {x:g} m/s is {force:g} N, which would supply energy, but a damper must dissipate "
                    "energy; give each force the same sign as its velocity (both are positive in extension)"
                )
    elif min(float(curve(np.array([s * 1e-12]))[0]) * s for s in (-1, 1)) <= 0 or curve.slope <= 0:
        raise InputError(
            "its slope at rest is not above 0, so the spring cannot carry the body; give forces that rise with "
            "deflection (both are positive in extension), or add a linear stiffness, as in [22e3, { ... }]"
        )
    for end, side in ((0, "below its first point"), (-1, "beyond its last point")):
        if curve.slopes[end] < 0:
            raise InputError(
                f"its force continues to fall {side}, by {-curve.slopes[end]:g} N per {over.unit}, because the curve "
                "is extended with the slope of its outermost segment; make the slope of this segment zero or positive"
            )
    return curve


def _surface(where: str, entry: Mapping[str, Any]) -> ForceSurface:
    """Returns the force of a damper as a function of velocity and deflection, from the table in the section."""
    given = read(where, SurfaceTable, entry)
    v, d, table = np.array(given.velocity), np.array(given.deflection), np.array(given.force)
    with error_in(f"{where}:"):
        _check_both_sides(v, VELOCITY)
        if not d[0] <= 0 <= d[-1]:
            raise InputError(
                f"deflection goes from {d[0]:g} to {d[-1]:g} m, but it must contain 0, the equilibrium; extend the "
                "range of deflection"
            )
        columns = []
        for at, column in zip(d, table.T, strict=True):
            with error_in(f"at deflection {at:g} m:"):
                x, force, _ = _from_rest(v, column, VELOCITY)
                columns.append(_check_curve(ForceCurve(x, force, slope_at_rest(x, force), ""), VELOCITY))
        words = f"{len(v)} velocities by {len(d)} deflections, at most {np.abs(table).max():g} N"
    return surface_of(columns[0].x, d, np.stack([one.force for one in columns], axis=1), words)


def _with_friction(curve: ForceCurve, friction: float, creep: float) -> ForceCurve:
    """Returns the characteristic with an added friction F tanh(v / v0), which does not change the slope that linear analysis
    uses.
    """
    v, force = friction_points(friction, creep)
    x = np.unique(np.concatenate([curve.x, v]))
    straight = np.interp(np.clip(x, v[0], v[-1]), v, force)
    words = (
        f"{curve.words}, and friction of {friction:g} N tanh(v / {creep:g} m/s) as {len(v) - 1} straight lines, within "
        f"{100 * FRICTION_ERROR:g} % of it"
    )
    return ForceCurve(x, curve(x) + straight, curve.slope, words)
