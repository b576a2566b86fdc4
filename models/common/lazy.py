"""Public names of a package that are imported when they are first used (PEP 562): `import sim` loads next to nothing."""

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Any


def attach(package: str, modules: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Returns `__getattr__`, `__dir__` and `__all__` of a package.

    Args:
        modules: full name of each module -> its public names; "" for a module that is public itself.
    """
    where = {name: module for module, names in modules.items() for name in names.split() or [module.rpartition(".")[2]]}

    def get(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(where[name])
        value = getattr(module, name) if modules[where[name]] else module
        setattr(sys.modules[package], name, value)  # the next access costs nothing
        return value

    return get, lambda: sorted(where), sorted(where)
