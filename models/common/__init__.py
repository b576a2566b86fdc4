"""What every floor stands on: arrays, errors, options, files, Ctrl-C, cores; it knows no vehicle."""
