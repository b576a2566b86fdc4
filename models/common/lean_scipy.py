"""SciPy's packages, imported without work that nothing here uses.

SciPy copies every public name of NumPy for its array API, and so imports NumPy's Fortran tools, test tools and masked arrays,
which takes a tenth of a second. Therefore these names are removed from NumPy's lists during the import. They stay importable.
It also parses the docstring of every function to add a table of other array libraries, which takes as long again for
`scipy.special`. That is left out, and so are the tables.
"""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from scipy import optimize, special

UNUSED = {"char", "core", "ctypeslib", "f2py", "ma", "polynomial", "rec", "strings", "testing"}

_listed = np.__all__, getattr(np, "__numpy_submodules__", None)
try:
    np.__all__ = [name for name in np.__all__ if name not in UNUSED]
    if _listed[1] is not None:  # names in `dir(numpy)`
        np.__numpy_submodules__ = _listed[1] - UNUSED
    from scipy import linalg
finally:
    np.__all__ = _listed[0]
    if _listed[1] is not None:
        np.__numpy_submodules__ = _listed[1]

__all__ = ["linalg", "optimize", "special"]


def __getattr__(name: str) -> ModuleType:
    """Imports a package of SciPy when it is first used."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    api: Any = sys.modules.get("scipy._lib._array_api")  # other versions of SciPy do without
    usual = getattr(api, "xp_capabilities", None)  # the decorator that adds the table
    if usual is not None:
        api.xp_capabilities = lambda **_: lambda function: function
    try:
        if name == "special":
            from scipy import special as package
        else:
            from scipy import optimize as package
    finally:
        if usual is not None:
            api.xp_capabilities = usual
    return package
