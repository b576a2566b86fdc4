"""Code that all packages use and that does not refer to vehicles: arrays, errors, options, files, units, interrupts and
threads.
"""
