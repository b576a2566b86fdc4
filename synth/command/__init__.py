"""Command `python -m synth`: the options, tables, figures and files of this command."""
