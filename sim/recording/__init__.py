"""Recording of runs as MCAP and Rerun files, with layouts for the viewers of these files. Start with `files.py`."""
