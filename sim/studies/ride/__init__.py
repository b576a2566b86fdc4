"""Ride, suspension travel and road holding, measured in a run and expected over a class of random roads.

Start with `metrics`, which defines what a metric is, and `run_metrics`, which contains `measure_run`. `expected` predicts
metrics from the spectrum of the road. `scores` and `score_table` compare controllers. `kinds` contains the metrics themselves.
"""
