"""Bump stops: where they begin and how they push back, in bump and rebound."""
