"""Runs, studies, campaigns and recordings."""
