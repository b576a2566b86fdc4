"""What `python -m synth` does: its options, tables, pictures and files."""
