"""The metrics. `standard` contains the metrics of published standards; every other metric has a separate file."""
