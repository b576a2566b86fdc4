"""Public names of a package that are imported at their first use (PEP 562), so that `import sim` is fast.

A function that is called by its public name checks its arguments first (`models.common.checks`). The packages themselves do not
use these names.
"""

import importlib
import sys
import types

TYPE_CHECKING = False  # the import of `typing` takes some milliseconds
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any


def attach(package: str, modules: "Mapping[str, str]") -> "tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]":
    """Returns `__getattr__`, `__dir__` and `__all__` of a package.

    Args:
        modules: public names of each module, by its full name; "" if the module itself is public.
    """
    where = {name: module for module, names in modules.items() for name in names.split() or [module.rpartition(".")[2]]}

    def get(name: str) -> "Any":
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(where[name])
        value = getattr(module, name) if modules[where[name]] else module
        if isinstance(value, types.FunctionType):
            from models.common.checks import at_the_door

            value = at_the_door(value)
        setattr(sys.modules[package], name, value)  # later accesses do not come here
        return value

    return get, lambda: sorted(where), sorted(where)
