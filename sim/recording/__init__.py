"""A run written down: MCAP, Foxglove, Rerun, their layouts and the viewer."""
