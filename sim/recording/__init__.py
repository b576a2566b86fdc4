"""Recording of runs: MCAP and Rerun files, and their layouts for viewers."""
