"""Bump stops: at which suspensions they are, where they begin and how they push back, in bump and rebound."""
