"""Numbers from a MATLAB file (versions 4 to 7) of any origin.

Only the parts of a controller are read: full matrices of numbers, and structs of such. scipy reads more, but is unsafe for files
of strangers: 184 bytes that claim a cell array of a billion make it take 8 GB, and cells 50000 deep, or a matrix of an unknown
type, end the process. The tests compare the results here with scipy's.

The format: MathWorks, "MAT-File Format", chapter 1.
"""

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.files import MIB

MOST_INSIDE = 8 * MIB  # of what is asked for, decompressed; a law of 200 states has 0.4
MOST_ELEMENTS = 100_000  # in a file
MOST_NUMBERS = 50_000  # in a matrix
HEADER = 4096  # bytes that hold a variable's flags, dimensions and name, and a struct's
SAVE = "save the matrices in MATLAB by save('FILE.mat', 'A', 'B', 'C', 'D', '-v7')"
HDF5 = b"\x89HDF\r\n\x1a\n"

# Types of elements and classes of arrays, by the format's numbers.
INT8, INT32, UINT32, MATRIX, COMPRESSED, UTF8 = 1, 5, 6, 14, 15, 16
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
NUMBERS = range(6, 16)
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}  # of numbers, of elements
TYPES_4 = ("f8", "f4", "i4", "i2", "u2", "u1")  # of version 4
WORDS = {
    CELL: "a cell array",
    STRUCT: "a struct",
    OBJECT: "a MATLAB object",
    CHAR: "text",
    SPARSE: "a sparse matrix",
    FUNCTION: "a function",
    OPAQUE: "a MATLAB object",
}

Variable = Array | dict[str, Array]
Contents = tuple[dict[str, Variable], dict[str, str]]


class DamagedError(Exception):
    """Bytes that violate the format, as text."""


class UnreadError(Exception):
    """Value that is no matrix of numbers, as text."""


@dataclass(frozen=True)
class _Header:
    """Beginning of a variable.

    Attributes:
        name: its name; empty for MATLAB's own data.
        kind: class of array.
        object: its class in MATLAB if it is an object.
    """

    name: str
    kind: int
    object: str = ""


def read_mat(content: bytes, names: Collection[str], fields: Collection[str] = ()) -> Contents:
    """Returns the variables of these names: numbers, or structs of numbers.

    Args:
        names: those that are read; a struct is read whatever its name, and of its fields these.
        fields: more fields that are read of a struct; of text, the numbers of its characters.

    Returns:
        By name, arrays of real or complex numbers, structs as mappings of such; and, by name, descriptions of all others.

    Raises:
        InputError: it is no such file, damaged, too large, or a variable of one of these names is not made of numbers.
    """
    if HDF5 in (content[:8], content[512:520]):
        raise InputError("is of version 7.3, which is HDF5 and not read; save it in MATLAB with '-v7'")
    try:
        return _version_5(content, names, fields) if content[126:128] in (b"IM", b"MI") else _version_4(content, names)
    except DamagedError as error:
        raise InputError(f"is no MATLAB file, or damaged: {error}; {SAVE}") from error


def _version_5(content: bytes, names: Collection[str], fields: Collection[str]) -> Contents:
    """Reads versions 5 to 7: variables are elements, compressed or not, whose parts are elements too."""
    order = "<" if content[126:128] == b"IM" else ">"
    variables: dict[str, Variable] = {}
    others: dict[str, str] = {}
    left = MOST_INSIDE
    for kind, data in _elements(content[128:], order):
        if kind not in (MATRIX, COMPRESSED):
            raise DamagedError(f"an element of type {kind} where a variable should be")
        matrix = _of_matrix(_inflated(data, HEADER), order) if kind == COMPRESSED else data
        known = _header(matrix, order)
        if known.kind in (OBJECT, OPAQUE) or (known.name not in names and known.kind != STRUCT):
            if known.name:
                others[known.name] = WORDS.get(known.kind, "numbers") + (f" of class {known.object}" if known.object else "")
            continue
        inflated = _inflated(data, left + 1) if kind == COMPRESSED else matrix
        left -= len(inflated)
        if left < 0:
            raise InputError(f"what is asked for takes more than {MOST_INSIDE // MIB} MiB; a controller's matrices are smaller")
        if known.name in variables:
            raise DamagedError(f"{known.name} is there twice")
        try:
            plain = _of_matrix(inflated, order, whole=True) if kind == COMPRESSED else matrix
            variables[known.name] = _value(plain, order, names, fields)
        except UnreadError as error:
            if known.name in names:
                raise InputError(f"{known.name} is {error}, and a controller is full matrices of numbers: {SAVE}") from error
            others[known.name] = str(error)
    return variables, others


def _version_4(content: bytes, names: Collection[str]) -> Contents:
    """Reads version 4: matrices one after the other, each with its type, rows, columns, and the length of its name."""
    at = 0
    variables: dict[str, Variable] = {}
    others: dict[str, str] = {}
    order = "<" if len(content) >= 4 and struct.unpack_from("<i", content)[0] in range(5000) else ">"
    while at < len(content):
        if len(content) - at < 20:
            raise DamagedError("it ends within a variable")
        kind, rows, columns, parts, length = struct.unpack_from(order + "5i", content, at)
        digits, sort = kind // 10 % 10, kind % 10
        if not (kind in range(5000) and digits in range(6) and sort in range(3) and parts in (0, 1) and 0 < length <= 64):
            raise DamagedError("it does not begin as one")
        start, numbers = at + 20 + length, rows * columns
        number = np.dtype(order + TYPES_4[digits])
        end = start + numbers * (1 + parts) * number.itemsize
        if rows < 0 or columns < 0 or end > len(content):
            raise DamagedError("a variable is longer than the file")
        name = content[at + 20 : start].split(b"\0")[0].decode("latin-1")
        if name not in names:
            others[name] = ("numbers", "text", "a sparse matrix")[sort]
        elif sort or numbers > MOST_NUMBERS:
            what = (f"a matrix of {numbers:.3g} numbers", "text", "a sparse matrix")[sort]
            raise InputError(f"{name} is {what}, and a controller is full matrices of numbers: {SAVE}")
        elif name in variables:
            raise DamagedError(f"{name} is there twice")
        else:
            read = np.frombuffer(content[start:end], number).reshape(1 + parts, columns, rows).astype(float)
            variables[name] = (read[0] + 1j * read[1] if parts else read[0]).T
        if len(variables) + len(others) > MOST_ELEMENTS:
            raise DamagedError(f"it has more than {MOST_ELEMENTS} variables")
        at = end
    return variables, others


def _elements(data: bytes | memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yields type and content of each element of some bytes, in order."""
    view, at = memoryview(data), 0
    for _ in range(MOST_ELEMENTS):
        if at == len(view):
            return
        if len(view) - at < 8:
            raise DamagedError("it ends within a variable")
        kind, size = struct.unpack_from(order + "II", view, at)
        if kind >> 16:  # a small one has its content in its tag
            kind, size, start, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            start, end = at + 8, at + 8 + size + (0 if kind == COMPRESSED else -size % 8)
        if start + size > min(end, len(view)):
            raise DamagedError("a variable, or a part of one, is longer than what holds it")
        yield kind, view[start : start + size]
        at = min(end, len(view))
    raise DamagedError(f"it has more than {MOST_ELEMENTS} elements")


def _inflated(data: memoryview, most: int) -> bytes:
    """Decompresses some bytes, up to a largest size."""
    try:
        return zlib.decompressobj().decompress(data, most)
    except zlib.error as error:
        raise DamagedError(f"it cannot be decompressed ({error})") from error


def _of_matrix(inflated: bytes | memoryview, order: str, whole: bool = False) -> memoryview:
    """Returns the content of the one variable that was compressed; its first bytes if it is not whole."""
    if len(inflated) < 8:
        raise DamagedError("a variable was cut")
    kind, size = struct.unpack_from(order + "II", inflated)
    if kind != MATRIX:
        raise DamagedError(f"an element of type {kind} where a variable should be")
    if whole and size != len(inflated) - 8:
        raise DamagedError("a variable is not as long as it says")
    return memoryview(inflated)[8:]


def _header(matrix: memoryview, order: str) -> _Header:
    """Reads the header of a variable."""
    parts = _elements(matrix[:HEADER], order)
    kind, _ = _flags(next(parts, None), order)
    if kind != OPAQUE:
        _dimensions(next(parts, None), order)
    name = _text(next(parts, None))
    if kind == OPAQUE:
        _text(next(parts, None))
    return _Header(name, kind, _text(next(parts, None)) if kind in (OBJECT, OPAQUE) else "")


def _value(matrix: memoryview, order: str, names: Collection[str], more: Collection[str]) -> Variable:
    """Returns plain numbers, or a struct of such with the fields of these names, and more that may be text."""
    parts = _elements(matrix, order)
    kind, _ = _flags(next(parts, None), order)
    if kind in NUMBERS:
        return _numbers(matrix, order)
    if kind != STRUCT:
        raise UnreadError(WORDS.get(kind, f"of class {kind}"))
    if _dimensions(next(parts, None), order) != (1, 1):
        raise UnreadError("an array of structs")
    _text(next(parts, None))
    length, fields, values = next(parts, None), next(parts, None), list(parts)
    if not length or not fields or length[0] != INT32 or fields[0] != INT8 or len(length[1]) != 4:
        raise DamagedError("a struct does not say what its fields are called")
    longest = struct.unpack_from(order + "i", length[1])[0]
    if not 0 < longest <= 64 or len(values) * longest != len(fields[1]) or any(kind != MATRIX for kind, _ in values):
        raise DamagedError("a struct does not have the fields that it says")
    kept: dict[str, Array] = {}
    for i, (_, value) in enumerate(values):
        name = bytes(fields[1][i * longest : (i + 1) * longest]).split(b"\0")[0].decode("latin-1")
        if name in kept:
            raise DamagedError(f"a struct has {name} twice")
        if name in names or name in more:
            try:
                kept[name] = _numbers(value, order, (*NUMBERS, CHAR) if name in more else NUMBERS)
            except UnreadError as error:
                raise UnreadError(f"a struct whose {name} is {error}") from error
    return kept


def _numbers(matrix: memoryview, order: str, kinds: Collection[int] = NUMBERS) -> Array:
    """Returns plain numbers of any dimensions from an array of one of these classes."""
    if not len(matrix):
        return np.zeros((0, 0))  # an empty field may be written as nothing at all
    parts = _elements(matrix, order)
    kind, is_complex = _flags(next(parts, None), order)
    if kind not in kinds:
        raise UnreadError(WORDS.get(kind, f"of class {kind}"))
    shape = _dimensions(next(parts, None), order)
    count = math.prod(shape)
    if count > MOST_NUMBERS:
        raise UnreadError(f"a matrix of {count:.3g} numbers")
    _text(next(parts, None))
    read = []
    for element, data in parts:
        number = TYPES.get(INT8 if element == UTF8 and kind == CHAR else element)
        if number is None or len(data) != count * np.dtype(number).itemsize:
            raise DamagedError("a matrix does not have the numbers that it says")
        read.append(np.frombuffer(data, order + number).astype(float).reshape(shape, order="F"))
    if len(read) != 1 + is_complex:
        raise DamagedError("a matrix has more parts, or fewer, than a matrix has")
    return read[0] + 1j * read[1] if is_complex else read[0]


def _flags(part: tuple[int, memoryview] | None, order: str) -> tuple[int, bool]:
    """Returns the class of an array, and True if its numbers are complex."""
    if part is None or part[0] != UINT32 or len(part[1]) != 8:
        raise DamagedError("a variable does not say what it is")
    word = struct.unpack_from(order + "I", part[1])[0]
    return word & 0xFF, bool(word & 0x800)


def _dimensions(part: tuple[int, memoryview] | None, order: str) -> tuple[int, ...]:
    if part is None or part[0] not in (INT32, UINT32) or len(part[1]) not in range(8, 129, 4):
        raise DamagedError("a variable has no dimensions")
    shape = struct.unpack(f"{order}{len(part[1]) // 4}i", part[1])
    if min(shape) < 0:
        raise DamagedError("a variable has dimensions below zero")
    return shape


def _text(part: tuple[int, memoryview] | None) -> str:
    if part is None or part[0] not in (INT8, UTF8) or len(part[1]) > 64:
        raise DamagedError("a variable has no name")
    return bytes(part[1]).decode("latin-1").rstrip("\0")
