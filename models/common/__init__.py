"""Common code of all packages, without vehicles: arrays, errors, options, files, units, interrupts and threads."""
