"""Recommendation of a controller: candidates of every family, searched in linear analysis and confirmed in MuJoCo."""
