"""What `python -m synth` prints, saves and checks."""
