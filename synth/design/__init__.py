"""Design of a gain or a law for any plant, with one file or folder per method; start with `feedback.py`."""
