"""The array type of every signature. Shapes and units are in the docstrings; entries are float64 unless those say complex."""

import numpy as np

Array = np.ndarray
