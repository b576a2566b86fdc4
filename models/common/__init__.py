"""Code that all packages use and that contains no vehicles: arrays, errors, options, files, units, interrupts and threads."""
