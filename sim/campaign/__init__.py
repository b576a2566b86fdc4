"""Every combination that a campaign file names, on every core, into one Parquet file."""

HERE = "local"  # Ray's own name for this machine's cores
MOST_RUNS = 10_000_000
