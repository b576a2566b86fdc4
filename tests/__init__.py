"""The claims. Tests call in their own process what commands run, and like these have one thread of BLAS."""

import gc
import os
import sys

for library in ("OPENBLAS", "MKL"):  # before numpy is imported
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Rarely: a process of tests has millions of objects that stay, and looking through them for garbage took a sixth of its time.
gc.set_threshold(100_000, 20, 20)

# Bytecode is kept, as in .ci/run: without it every process of the tests compiles all that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
