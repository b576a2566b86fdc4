"""Range of validity of linear analysis over a grid of bumps."""
