"""Lazy imports: public names of a package, and names in registries, are imported at their first use.

Lazy imports keep `import sim` fast. A function that is called by its public name checks its arguments first
(`models.common.checks`). Code inside the packages does not use the public names.
"""

import ast
import importlib
import sys
import types
from pathlib import Path

TYPE_CHECKING = False  # the import of `typing` would take some milliseconds
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def resolve_name(where: str) -> "Any":
    """Returns the object or module that a registry entry "module:name" or "module" refers to."""
    module, _, name = where.partition(":")
    found = importlib.import_module(module)
    return getattr(found, name) if name else found


def attach(package: str, file: str) -> "tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]":
    """Returns `__getattr__`, `__dir__` and `__all__` for a package whose public names are imported lazily.

    Args:
        package: name of the package.
        file: path of its `__init__.py`. The public names of the package are the names that `__init__.py` imports for type
            checkers.
    """
    tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    imports = [node for one in tree.body if isinstance(one, ast.If) for node in one.body if isinstance(node, ast.ImportFrom)]
    where = {alias.name: node.module or "" for node in imports for alias in node.names}

    def get(name: str) -> "Any":
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(where[name])
        value = getattr(module, name, None) or importlib.import_module(f"{where[name]}.{name}")
        if isinstance(value, types.FunctionType):
            from models.common.checks import check_arguments

            value = check_arguments(value)
        # Later accesses find this attribute, so that Python does not call `get` again
        setattr(sys.modules[package], name, value)
        return value

    return get, lambda: sorted(where), sorted(where)
