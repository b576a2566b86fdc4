"""Ride, suspension travel and road holding, both measured in a run and expected over all random roads of a class.

Start with `metrics`, which defines what a metric is, and `run_metrics`, which contains `measure_run`. `expected` predicts
metrics from the spectrum of the road. `scores` and `score_table` compare controllers. The package `kinds` contains the metrics
themselves.
"""
