"""Foundations of all packages: arrays, errors, options, files, Ctrl-C, threads; no vehicle."""
