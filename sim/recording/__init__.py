"""Recording of runs as MCAP and Rerun files, with layouts for their viewers. Start with `files.py`."""
