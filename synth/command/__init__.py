"""The command `python -m synth`: its options, tables, pictures and files."""
