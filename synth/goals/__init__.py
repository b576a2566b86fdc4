"""Static gains for goals: the least maximum over plants, tolerances and bands, subject to bounds, of a given structure."""
