"""Checks of values by their annotations: a value that does not fit is an `InputError` that names it.

`models.common.lazy` wraps every public function in `at_the_door`; calls within the packages are not checked. Dataclasses are
`Checked`, or call `check_fields` in `__post_init__`. An annotation in quotes allows anything: type checkers alone resolve it.
"""

import collections.abc
import inspect
import math
import numbers
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache, wraps
from pathlib import Path
from typing import Annotated, Any, NoReturn, Protocol, TypeVar, Union, get_args, get_origin

import numpy as np

from models.common.arrays import Array, check_unmasked, is_masked
from models.common.errors import InputError, quoted

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Must:
    """Further condition of an annotation, as in `Annotated[float, Must("a number above 0", lambda value: value > 0)]`.

    Attributes:
        words: the allowed values; after a comma, what is added to the words of the annotated type.
        holds: True for an allowed value, which has the annotated type.
    """

    words: str
    holds: Callable[[Any], bool]

    def __repr__(self) -> str:  # in `help`, where the condition itself would be an address
        return repr(self.words.removeprefix(", "))


LONGEST_NAME = 60  # characters

AT_LEAST_ONE = Must(", at least one", lambda value: len(value) > 0)
Positive = Annotated[float, Must("a number above 0", lambda value: 0 < value < math.inf)]
NotNegative = Annotated[float, Must("a number from 0 upwards", lambda value: 0 <= value < math.inf)]
Bound = Annotated[float, Must("a number above 0, or infinity", lambda value: value > 0)]
Index = Annotated[int, Must("a whole number from 0 upwards", lambda value: value >= 0)]
Vector = Annotated[Array, Must("a list of finite numbers", lambda value: value.ndim == 1 and bool(np.isfinite(value).all()))]
Matrix = Annotated[Array, Must("a matrix of finite numbers", lambda value: value.ndim == 2 and bool(np.isfinite(value).all()))]
Name = Annotated[
    str,
    Must(
        f"letters, digits and '_', at most {LONGEST_NAME}, no digit first",
        lambda value: value.isidentifier() and len(value) <= LONGEST_NAME,
    ),
]


class _UnfitError(Exception):
    """A value that does not fit.

    Attributes:
        place: where it is within the value asked about, as in "[0]".
        value: the value.
        words: the allowed values.
    """

    def __init__(self, value: Any, words: str, place: str = "") -> None:
        super().__init__(words)
        self.place, self.value, self.words = place, value, words


@dataclass(frozen=True)
class _Check:
    """Check of an annotation.

    Attributes:
        words: the allowed values.
        read: returns the value, a list as the annotated array or tuple; raises `_UnfitError`.
    """

    words: str
    read: Callable[[Any], Any]


def check(name: str, value: Any, annotation: Any) -> Any:
    """Returns a value that fits its annotation, a list as the annotated array or tuple.

    Raises:
        InputError: it does not fit; the message has the name.
    """
    check_unmasked(name, value)
    try:
        return _check(annotation).read(value)
    except _UnfitError as error:
        raise InputError(f"{name}{error.place} = {quoted(error.value)} is not allowed; give {error.words}") from None


def plain(value: Any) -> Any:
    """Returns NumPy's scalar, or its array of no dimension, as a number of Python; any other value unchanged."""
    scalar = isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.ndim)
    return value.item() if scalar and not is_masked(value) else value


def check_shape(name: str, value: Array, shape: tuple[int, ...], why: str) -> None:
    """Raises an InputError if an array has another shape; `why` says what sets it."""
    if value.shape != shape:
        raise InputError(f"{name} has shape {value.shape}; expected {shape}, {why}")


def check_fields(value: Any) -> None:
    """Checks the fields of a dataclass, for `__post_init__`; lists become the annotated arrays and tuples.

    Raises:
        InputError: a field does not fit its annotation; the message has its name.
    """
    for name, annotation in _annotated(type(value)):
        given = getattr(value, name)
        fitting = check(name, given, annotation)
        if fitting is not given:
            object.__setattr__(value, name, fitting)


class ReadOnly(dict[str, Any]):
    """A dict that refuses changes, where a changed entry would pass unchecked."""

    def _refused(self, *arguments: Any, **named: Any) -> NoReturn:
        raise InputError(
            "parameters, weights and controllers of a vehicle are read-only; use vehicle.with_parameters(sprung_mass=...), "
            "or dataclasses.replace"
        )

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refused  # pyright: ignore

    def __reduce__(self) -> tuple[type["ReadOnly"], tuple[dict[str, Any]]]:  # a dict's would set items, copied or unpickled
        return ReadOnly, (dict(self),)


class Checked:
    """Base of dataclasses whose fields fit their annotations; see `check_fields`."""

    def __post_init__(self) -> None:
        check_fields(self)


@cache
def _annotated(of: type) -> tuple[tuple[str, Any], ...]:
    return tuple((field.name, field.type) for field in fields(of) if _check(field.type) is not ANYTHING)


def at_the_door(function: F) -> F:
    """Returns a function that checks its arguments by their annotations before it is called."""
    signature = inspect.signature(function)
    annotations = {name: parameter.annotation for name, parameter in signature.parameters.items() if name != "self"}

    @wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        bound = signature.bind(*arguments, **named)
        for name, value in bound.arguments.items():
            bound.arguments[name] = check(name, value, annotations.get(name, Any))
        return function(*bound.args, **bound.kwargs)

    return checked  # pyright: ignore[reportReturnType]


ANYTHING = _Check("anything", lambda value: value)


@cache
def _check(annotation: Any) -> _Check:
    """Returns the check of an annotation; `ANYTHING` for one that is unknown."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _further(_check(inner[0]), *inner[1:])
    if origin in (Union, types.UnionType):
        return _either([_check(one) for one in inner])
    if origin is tuple:
        return _each(_check(inner[0])) if inner[1:] == (...,) else _row([_check(one) for one in inner])
    if isinstance(origin, type) and issubclass(origin, collections.abc.Mapping):
        return _mapping(*(_check(one) for one in inner))
    if origin is collections.abc.Callable or annotation is Callable:
        return _simple("a function", callable)
    if isinstance(origin, type) and issubclass(origin, Iterable):
        return _each(_check(inner[0]))
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    if isinstance(annotation, type) and annotation is not object:
        article = "an" if annotation.__name__[0] in "AEIOU" else "a"
        return _simple(f"{article} {annotation.__name__}", lambda value: isinstance(value, annotation))
    return ANYTHING


def _simple(words: str, fits: Callable[[Any], bool]) -> _Check:
    def read(value: Any) -> Any:
        value = plain(value)
        if not fits(value):
            raise _UnfitError(value, words)
        return value

    return _Check(words, read)


def _further(base: _Check, must: Any) -> _Check:
    if not isinstance(must, Must):
        return base
    words = base.words + must.words if must.words.startswith(",") else must.words

    def read(value: Any) -> Any:
        try:
            fitting = base.read(value)
        except _UnfitError as error:
            raise error if error.place else _UnfitError(value, words) from error
        if not must.holds(fitting):
            raise _UnfitError(value, words)
        return fitting

    return _Check(words, read)


def _either(checks: list[_Check]) -> _Check:
    if any(one is ANYTHING for one in checks):
        return ANYTHING
    words = " or ".join(one.words for one in checks)

    def read(value: Any) -> Any:
        errors = []
        for one in checks:
            try:
                return one.read(value)
            except _UnfitError as error:
                errors.append(error)
        raise next((error for error in errors if error.place), _UnfitError(value, words))

    return _Check(words, read)


def _each(item: _Check) -> _Check:
    words = f"a list, each item {item.words}"

    def read(value: Any) -> Any:
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
            raise _UnfitError(value, words)
        items = tuple(_at(f"[{i}]", item, one) for i, one in enumerate(value))
        same = isinstance(value, tuple) and all(one is old for one, old in zip(items, value, strict=True))
        return value if same else items

    return _Check(words, read)


def _row(checks: list[_Check]) -> _Check:
    words = f"{len(checks)} values: {', '.join(one.words for one in checks)}"

    def read(value: Any) -> Any:
        if not isinstance(value, tuple | list) or len(value) != len(checks):
            raise _UnfitError(value, words)
        return tuple(_at(f"[{i}]", one, part) for i, (one, part) in enumerate(zip(checks, value, strict=True)))

    return _Check(words, read)


def _mapping(keys: _Check, values: _Check) -> _Check:
    words = f"a mapping from {keys.words} to {values.words}"

    def read(value: Any) -> Any:
        if not isinstance(value, Mapping):
            raise _UnfitError(value, words)
        for key, one in value.items():
            _at("", keys, key)
            _at(f"[{quoted(key)}]", values, one)
        return value

    return _Check(words, read)


def _at(place: str, item: _Check, value: Any) -> Any:
    try:
        return item.read(value)
    except _UnfitError as error:
        raise _UnfitError(error.value, error.words, place + error.place) from error


def is_finite(value: Any) -> bool:
    """Returns True for a real and finite number, of numpy or not."""
    value = plain(value)
    try:
        return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def _number(value: Any) -> Any:
    value = plain(value)
    if not (is_finite(value) or (isinstance(value, float) and math.isinf(value))):
        raise _UnfitError(value, "a number")
    return value


def _array(value: Any) -> Array:
    """Returns an array of numbers, entries that are not finite included."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise _UnfitError(value, "an array of numbers") from error
    if array.dtype.kind not in "biufc" or not array.ndim:
        raise _UnfitError(value, "an array of numbers")
    return array


def _path(value: Any) -> Path:
    if not isinstance(value, str | Path):
        raise _UnfitError(value, "a path")
    return Path(value)


_PLAIN: Mapping[Any, _Check] = {
    float: _Check("a number", _number),
    int: _simple("a whole number", lambda value: isinstance(value, numbers.Integral) and not isinstance(value, bool)),
    bool: _simple("True or False", lambda value: isinstance(value, bool | np.bool_)),
    str: _simple("a text", lambda value: isinstance(value, str)),
    types.NoneType: _simple("None", lambda value: value is None),
    None: _simple("None", lambda value: value is None),
    Path: _Check("a path", _path),
    Array: _Check("an array of numbers", _array),
    Any: ANYTHING,
    Protocol: ANYTHING,
}
