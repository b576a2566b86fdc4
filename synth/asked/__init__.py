"""What `python -m synth` can be asked, and what of it goes together."""
