"""Numbers with units, such as `90 km/h`, `22 N/mm` or `8 Hz`. The units in files, options and tables are all converted by the
table of units in this module.
"""

import math
import re
from collections.abc import Mapping
from fractions import Fraction  # fractions are exact, so that 35 mm is exactly 0.035 m without intermediate rounding
from typing import Any

from models.common.errors import InputError, short_repr

LENGTH = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
TIME = {"s": 1.0, "ms": 1e-3}
VELOCITY = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "in/s": 0.0254, "ft/s": 0.3048}
FORCE = {"N": 1.0, "kN": 1e3, "daN": 10.0, "lbf": 4.4482216152605}
MOMENT = {"N m": 1.0, "kN m": 1e3}
# Factors that convert units to SI units, grouped by powers of kg, m, s, A and K. Angles are pure numbers, so 1 Hz is 2 pi
# rad/s.
SIZES: Mapping[tuple[int, ...], Mapping[str, float]] = {
    (1, 0, 0, 0, 0): {"kg": 1.0, "t": 1e3, "lb": 0.45359237},
    (0, 1, 0, 0, 0): LENGTH,
    (0, 0, 1, 0, 0): TIME | {"min": 60.0, "h": 3600.0},
    (0, 1, -1, 0, 0): {"mph": 0.44704},
    (0, 1, -2, 0, 0): {"g": 9.80665, "mg": 9.80665e-3},
    (1, 1, -2, 0, 0): FORCE | {"kgf": 9.80665},
    (1, 2, -2, 0, 0): {"J": 1.0},
    (1, -1, -2, 0, 0): {"Pa": 1.0, "bar": 1e5, "psi": 6894.757293168361},
    (0, 3, 0, 0, 0): {"l": 1e-3},
    (0, 0, 0, 1, 0): {"A": 1.0},
    (0, 0, 0, 0, 1): {"K": 1.0},
    (1, 2, -3, -1, 0): {"V": 1.0},
    (0, 0, -1, 0, 0): {"Hz": 6.283185307179586, "rpm": 0.10471975511965977},
    (0, 0, 0, 0, 0): {"1": 1.0, "-": 1.0, "rad": 1.0, "deg": 0.017453292519943295, "%": 1e-2},
}
WORDS: Mapping[str, str] = {  # other names of units, written in lower case
    **{f"{prefix}{word}": f"{short}m" for prefix, short in (("", ""), ("kilo", "k"), ("centi", "c"), ("milli", "m"))
       for word in ("metre", "metres", "meter", "meters")},
    **{word: unit for unit, words in {
        "in": 'inch inches "', "ft": "foot feet '", "s": "sec second seconds", "ms": "msec millisecond milliseconds",
        "N": "n newton newtons", "kN": "kn kilonewton kilonewtons", "daN": "dan", "lbf": "pound_force", "kgf": "kg_force kp",
        "N m": "nm", "kN m": "knm", "Hz": "hz", "km/h": "kph kmh", "in/s": "ips", "lb": "lbs", "N s": "ns", "kN s": "kns",
        "m/s": "mps", "m/s2": "mps2", "deg": "° degree degrees", "l": "litre litres liter liters",
    }.items() for word in words.split()},
    "n m": "N m", "kn m": "kN m",
}  # fmt: skip
# The last two prefixes are both "micro": the micro sign and the Greek letter mu
PREFIXES = {"M": 1e6, "k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "\u00b5": 1e-6, "\u03bc": 1e-6}
# Units that may have a prefix. The gram is missing, because the letter g means the gravitational acceleration
PREFIXED_UNITS = ("m", "s", "N", "Hz", "J", "rad", "Pa", "l", "A", "V")
COMMA = re.compile(r"\s*[+-]?\d*,\d")
QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*(.*?)\s*")  # pattern of a number with its unit
FACTOR = re.compile(r"(\D+?|1)\^?([2-9]?)")
SIGNS = str.maketrans({"²": "2", "³": "3", "·": " ", "*": " "})
TIMES = re.compile(r"(?<=\w)[-.](?=[^\W\d])")  # the separator between two units of a product, as in N-s/m or kg.m2
POUND = re.compile(r"\blbs?\b")


def unit_named(text: str) -> str:
    """Returns the usual name of a unit or, if the unit is unknown, the text in lower case."""
    return WORDS.get(text.lower(), text.lower())


def quantity(text: str, unit: str, what: str = "") -> float:
    """Converts a number with its unit, such as `70 mm` or `8Hz`, to another unit.

    A number without a unit is assumed to be in the unit of the result.

    Args:
        text: the number, with or without a unit.
        unit: unit of the result, such as m, rad/s or N s/m; empty, "-" or "1" for a pure number.
        what: name of the number, for messages.

    Raises:
        InputError: the text is not a number with a unit, or the unit is unknown or of the wrong dimension.
    """
    match, pure = QUANTITY.fullmatch(text), unit in ("", "-", "1")
    said = f"{what} = {short_repr(text)}" if what else short_repr(text)
    if COMMA.match(text):
        raise InputError(f"{said} has a decimal comma; write a decimal point, as in {_example(unit)}")
    if match is None:
        raise InputError(f"{said} is not a number; give a number{'' if pure else f' in {unit}, or a number with its unit'}")
    number, written = match.groups()
    size, wanted = _size(written or unit), _size(unit)
    if written and (size is None or wanted is None or size[1] != wanted[1]):
        expected = "a pure number is expected; omit unit and quotes" if pure else f"a unit of {unit} is expected"
        force = POUND.sub("lbf", written)  # this table uses the pound (lb) as a unit of mass, not of force
        example = number if pure else f'"{number} {force}"' if unit_size(force, unit) else _example(unit)
        unknown = "unknown " * (size is None)
        raise InputError(f"{said} has the {unknown}unit {short_repr(written)}, but {expected}, as in {example}")
    return float(Fraction(number) * size[0] / wanted[0]) if size and wanted and written else float(number)


def unit_size(unit: str, si: str) -> float | None:
    """Returns the factor from a unit to an SI unit; None if the unit is unknown or has another dimension."""
    size, wanted = _size(unit), _size(si)
    return float(size[0] / wanted[0]) if size and wanted and size[1] == wanted[1] else None


def in_unit(value: Any, unit: str, what: str) -> Any:
    """Converts a text that contains a number with a unit, as `quantity` does. Returns a text that contains no number, or any
    other value, unchanged.

    Raises:
        InputError: `quantity` raises this error, or a number in quotes has no unit.
    """
    match = QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if match is None and not (isinstance(value, str) and COMMA.match(value)):
        return value
    number = quantity(value, unit, what)
    if match and not match[2]:
        add = "" if unit in ("", "-", "1") else f"add the unit, as in {_example(unit)}, or "
        raise InputError(
            f"{what} = {short_repr(value)} has no unit, but only a number with a unit may be in quotes; {add}omit the quotes"
        )
    return number


def setting(name: str, value: str, unit: str = "1") -> float:
    """Converts a text that contains a number, with or without a unit, to a given unit.

    Raises:
        InputError: the value is not a finite number, or its unit is unknown or of the wrong dimension.
    """
    try:
        number = float(value)
    except ValueError:
        number = quantity(value, unit, name)
    if not math.isfinite(number):
        raise InputError(f"{name} = {value!r} is not allowed; give a finite number")
    return number


def _example(unit: str) -> str:
    """Returns an example of a number with the unit in the argument, in quotes."""
    return '"1.5"' if unit in ("", "-", "1") else f'"1.5 {unit}"'


def _size(unit: str) -> tuple[Fraction, tuple[int, ...]] | None:
    """Returns the factor from a unit to SI units, and the unit's powers of kg, m, s, A and K; None if the unit is unknown.

    Every factor after a slash is a divisor, as in N/m s.
    """
    size, powers = Fraction(1), (0, 0, 0, 0, 0)
    # Parentheses enclose a unit in a denominator, as in N/(m/s)
    text = re.sub(r"/\s*\(([^()/]+)/([^()/]+)\)", r" \2/\1", TIMES.sub(" ", unit.translate(SIGNS)))
    for i, part in enumerate(re.sub(r"[()]", "", text).split("/")):
        for factor in part.split():
            match = FACTOR.fullmatch(factor)
            one = _unit(match[1]) if match else None
            if match is None or one is None:
                return None
            power = int(match[2] or 1) * (-1 if i else 1)
            size *= one[0] ** power
            powers = tuple(sum_ + power * own for sum_, own in zip(powers, one[1], strict=True))
    return size, powers


def _unit(name: str) -> tuple[Fraction, tuple[int, ...]] | None:
    """Returns the factor to SI units and the powers of a unit that is not a product of units, as `_size` does."""
    usual = unit_named(name)
    for powers, sizes in SIZES.items():
        for known in (name, usual):
            if known in sizes:
                return Fraction(repr(sizes[known])), powers
    if name[1:] in PREFIXED_UNITS and name[0] in PREFIXES:
        size = _size(name[1:])
        return size and (size[0] * Fraction(repr(PREFIXES[name[0]])), size[1])
    return _size(usual) if usual != name.lower() else None
