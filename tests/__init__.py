"""What is claimed. Tests call in their own process what commands run, and like these have one thread of BLAS."""

import os

for library in ("OPENBLAS", "MKL"):  # before numpy is imported
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
