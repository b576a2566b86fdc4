"""The metrics. `standard` contains those of the standards; every other metric has a file of its own."""
