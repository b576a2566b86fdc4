"""Command `python -m synth`: its options, tables, figures and files."""
