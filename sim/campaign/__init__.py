"""Every combination that a campaign file names, on every core, into one Parquet file."""
