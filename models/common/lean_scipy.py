"""SciPy's linear algebra, imported without parts of NumPy that nothing here uses.

SciPy copies every public name of NumPy for its array API, and so imports NumPy's Fortran tools, test tools and masked arrays,
which takes a tenth of a second. Therefore these names are removed from NumPy's lists during the import. They stay importable.
"""

import numpy as np

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

__all__ = ["linalg"]
