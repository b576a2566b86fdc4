"""Checks of values against their type annotations. A value that does not fit raises an `InputError` with the name of the
argument.

`models.common.lazy` wraps every public function in `check_arguments`. Arguments of calls from inside the packages are not
checked. Dataclasses derive from `CheckedFields`, or call `check_fields` in `__post_init__`. An annotation in quotes allows any
value, because only type checkers resolve annotations in quotes.
"""

import inspect
import math
import numbers
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import wraps
from operator import attrgetter
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, NoReturn, TypeVar, Union, get_args, get_origin

import numpy as np

from models.common.arrays import Array, check_unmasked, is_masked
from models.common.errors import InputError, short_repr
from models.common.files import path_from
from models.common.units import in_unit

F = TypeVar("F", bound=Callable[..., Any])
HERE = "\N{WHITE SQUARE}"  # placeholder that a `models.common.schema.Key` replaces in its messages by the name of the value


@dataclass(frozen=True)
class Must:
    """Additional condition of an annotation, as in `Annotated[float, Must("a number above 0", lambda value: value > 0)]`.

    Attributes:
        words: description of the allowed values. If `words` begins with a comma or space, messages append it to the description
            of the type.
        holds: function that takes a value of the annotated type, and returns True if the value is allowed.
        unit: unit of a number; empty for other values. A text with a number and a different unit is converted: if the unit is
            m, "60 mm" becomes 0.06.
    """

    words: str
    holds: Callable[[Any], bool]
    unit: str = ""

    def __repr__(self) -> str:  # `help` shows this text; without it, `help` would show the memory address of the condition
        return repr(self.words.lstrip(", "))


AT_LEAST_ONE = Must(", at least one", lambda value: len(value) > 0)
Positive = Annotated[float, Must("a number above 0", lambda value: 0 < value < math.inf)]
NotNegative = Annotated[float, Must("a number from 0 upwards", lambda value: 0 <= value < math.inf)]
Bound = Annotated[float, Must("a number above 0, or infinity", lambda value: value > 0)]
Length = Annotated[float, Must(" in m", lambda value: True, "m")]
Time = Annotated[float, Must(" in s", lambda value: True, "s")]
PositiveSpeed = Annotated[float, Must("a number above 0 in m/s", lambda value: 0 < value < math.inf, "m/s")]
PositiveTime = Annotated[float, Must("a number above 0 in s", lambda value: 0 < value < math.inf, "s")]
Index = Annotated[int, Must("an integer from 0 upwards", lambda value: value >= 0)]
Vector = Annotated[Array, Must("a list of finite numbers", lambda value: value.ndim == 1 and bool(np.isfinite(value).all()))]
Matrix = Annotated[Array, Must("a matrix of finite numbers", lambda value: value.ndim == 2 and bool(np.isfinite(value).all()))]
Name = Annotated[str, Must("letters, digits and '_', no digit first", str.isidentifier)]
PLAIN = (str, float, int, bool)
WORDS: Mapping[Any, str] = {
    Any: "anything",
    Array: "an array of numbers",
    Callable: "a function",
    NoneType: "None",
    Path: "a path",
    bool: "True or False",
    float: "a number",
    int: "an integer",
    str: "a text",
}


def check(name: str, value: Any, annotation: Any) -> Any:
    """Returns a value if it fits its annotation. A list is converted to the type of the annotation, an array or a tuple.

    If the annotation has a unit, a text is also allowed: `height="60 mm"` is 0.06.

    Args:
        name: name of the value, for messages.
        value: value to check.
        annotation: type annotation that the value must fit.

    Raises:
        InputError: the value does not fit the annotation, or has an unknown unit or a unit of the wrong dimension.
    """
    if _obviously(value, annotation):
        return value
    check_unmasked(name, value)
    try:
        return _fit("", value, annotation)
    except _UnfitError as error:
        place, part, allowed, message = error.args
        message = message or f"{HERE} = {short_repr(part)} is not allowed; give {_words(allowed)}"
        raise InputError(message.replace(HERE, f"{name}{place}")) from None


def check_fields(value: Any, prefix: str = "") -> None:
    """Checks the fields of a dataclass; the method `__post_init__` of the dataclass calls this function. A list in a field is
    converted to the type of the annotation, an array or a tuple.

    Args:
        value: the instance of the dataclass.
        prefix: text in front of the name of a field, for messages.

    Raises:
        InputError: a field does not fit its annotation.
    """
    for field in fields(value):
        given = getattr(value, field.name)
        fitting = check(f"{prefix}{field.name}", given, field.type)
        if fitting is not given:
            object.__setattr__(value, field.name, fitting)


class CheckedFields:
    """Base class of dataclasses whose fields are checked against their annotations; see `check_fields`."""

    def __post_init__(self) -> None:
        check_fields(self)


def check_shape(name: str, value: Array, shape: tuple[int, ...], why: str) -> None:
    """Raises an InputError if an array does not have the expected shape. The argument `why` explains the expected shape in the
    message.
    """
    if value.shape != shape:
        raise InputError(f"{name} has shape {value.shape}; expected {shape}, {why}")


def check_arguments(function: F) -> F:
    """Returns a function that checks its arguments against their annotations before it runs.

    If the function returns a vehicle, a run or a list of runs, the warnings of the result are issued, each only once.
    """
    signature, former = inspect.signature(function), getattr(function, "former_names", {})

    @wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        bound = signature.bind(*arguments, **{former.get(name, name): value for name, value in named.items()})
        for name, value in bound.arguments.items():
            if name not in ("self", "cls"):
                bound.arguments[name] = check(name, value, signature.parameters[name].annotation)
        given = function(*bound.args, **bound.kwargs)
        several = given if isinstance(given, list) else [given]
        for doubt in dict.fromkeys(doubt for one in several for doubt in getattr(one, "warnings", ())):
            warnings.warn(doubt, stacklevel=2)
        return given

    return checked  # pyright: ignore[reportReturnType]


def accept_former_names(**names: str) -> Callable[[F], F]:
    """Returns a decorator for a public function or dataclass that also accepts former names of arguments.

    Attributes of the dataclass can also be read by former names.

    Args:
        names: the present name for each former name.
    """

    def decorate(one: F) -> F:
        if not isinstance(one, type):
            one.__dict__["former_names"] = names  # the function `check_arguments` reads this attribute
            return one
        init = one.__init__

        @wraps(init)
        def accepting(self: Any, *arguments: Any, **named: Any) -> None:
            init(self, *arguments, **{names.get(name, name): value for name, value in named.items()})

        one.__init__ = accepting
        for former, name in names.items():
            setattr(one, former, property(attrgetter(name), doc=f"Former name of `{name}`."))
        return one  # pyright: ignore[reportReturnType]

    return decorate


def forwarded_attribute(path: str) -> Any:
    """Returns a property that reads an attribute of another object, such as `road.speed` for `self.road.speed`."""
    return property(attrgetter(path), doc=f"The attribute `{path}`.")


class ReadOnly(dict[str, Any]):
    """Dictionary that refuses changes, because changed entries would not be checked."""

    def _refused(self, *arguments: Any, **named: Any) -> NoReturn:
        raise InputError(
            "parameters, weights and controllers of a vehicle are read-only; make a changed copy with "
            "vehicle.with_parameters(sprung_mass=...), or dataclasses.replace"
        )

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refused  # pyright: ignore

    # The `__reduce__` of `dict` would set items while an object is copied or unpickled
    def __reduce__(self) -> tuple[type["ReadOnly"], tuple[dict[str, Any]]]:
        return ReadOnly, (dict(self),)


def is_finite(value: Any) -> bool:
    """Returns True for a real and finite number, including numbers of NumPy."""
    value = plain(value)
    try:
        return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def plain(value: Any) -> Any:
    """Returns a NumPy scalar or an array without dimensions as a Python number, and any other value unchanged."""
    scalar = isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.ndim)
    return value.item() if scalar and not is_masked(value) else value


class _UnfitError(Exception):
    """Raised for a value that does not fit its annotation.

    The first two arguments of the exception are the place of the wrong part in the value, such as "[0]", and the wrong part
    itself. The last two arguments of the exception are the annotation that the wrong part does not fit, and a message. If the
    message is empty, the default message is used.
    """


def _fit(place: str, value: Any, annotation: Any, allowed: Any = None) -> Any:
    """Returns a value if it fits an annotation. `allowed` is the whole annotation if `annotation` is only a part of `allowed`."""
    given, allowed = value, annotation if allowed is None else allowed
    outer, inner, fits = get_origin(annotation) or annotation, get_args(annotation), True
    if outer is Annotated:
        key = inner[1]
        try:
            if not isinstance(key, Must):
                return key.read(plain(value), {})
            value = in_unit(value, key.unit, HERE) if key.unit else value
        except InputError as error:
            raise _UnfitError(place, given, allowed, str(error)) from None
        value = _fit(place, value, inner[0], allowed)
        fits = key.holds(value)
    elif outer in (Union, UnionType):
        errors = []
        for one in inner:
            try:
                return _fit(place, value, one, allowed)
            except _UnfitError as error:
                errors.append(error)
        raise next((error for error in errors if error.args[0] != place), errors[0])
    elif not isinstance(outer, type) or outer is Any:
        return value
    elif inner and issubclass(outer, Mapping):
        fits = isinstance(value, Mapping)
        for key, one in value.items() if fits else ():
            if not (_obviously(key, inner[0]) and _obviously(one, inner[1])):
                _fit(place, key, inner[0])
                _fit(f"{place}[{short_repr(key)}]", one, inner[1])
    elif inner and issubclass(outer, Iterable):
        value = plain(value)
        if fits := isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping):
            items = tuple(value)
            each = inner if outer is tuple and inner[-1] is not ... else inner[:1] * len(items)
            if fits := len(each) == len(items):
                pairs = enumerate(zip(items, each, strict=True))
                value = tuple(item if _obviously(item, of) else _fit(f"{place}[{i}]", item, of) for i, (item, of) in pairs)
    else:
        value, fits = _simple(value, outer)
    if not fits:
        raise _UnfitError(place, given, allowed, "")
    return value


def _obviously(value: Any, annotation: Any) -> bool:
    """Returns True for a text, number or truth value that fits without further checks, as most fields of a linear model do."""
    # A comparison of a number with itself is False only for NaN
    return type(value) is annotation and annotation in PLAIN and value == value


def _simple(value: Any, wanted: type) -> tuple[Any, bool]:
    """Returns a value, converted if necessary, and a flag that is True if the value has the requested type.

    Other types are converted to arrays and paths if the annotation requests an array or a path.
    """
    if wanted is Array:
        try:
            array = np.asarray(value)
        except (TypeError, ValueError):
            return value, False
        return array, array.dtype.kind in "biufc" and array.ndim > 0
    value = plain(value)
    if wanted is float:
        return value, is_finite(value) or (isinstance(value, float) and math.isinf(value))
    if wanted is int:
        return value, isinstance(value, numbers.Integral) and not isinstance(value, bool)
    value = path_from(value) if wanted is Path and isinstance(value, str) else value
    return value, isinstance(value, wanted)


def _words(annotation: Any) -> str:
    """Returns a description of the values that an annotation allows."""
    outer, inner = get_origin(annotation) or annotation, get_args(annotation)
    if outer is Annotated:
        words = getattr(inner[1], "words", "")
        return (_words(inner[0]) if words[:1] in ("", ",", " ") else "") + words
    if outer in (Union, UnionType):
        return " or ".join(map(_words, inner))
    if outer in WORDS or not isinstance(outer, type):
        return WORDS.get(outer, "anything")
    if inner and issubclass(outer, Mapping):
        return f"a mapping from {_words(inner[0])} to {_words(inner[1])}"
    if inner:
        fixed = outer is tuple and inner[-1] is not ...
        every = f"a list in which each item is {_words(inner[0])}"
        return f"{len(inner)} values: {', '.join(map(_words, inner))}" if fixed else every
    # If a type is not public, its class attribute `public_name` tells the user how to get such a value.
    return vars(outer).get("public_name", f"{'an' if outer.__name__[0] in 'AEIOU' else 'a'} {outer.__name__}")
