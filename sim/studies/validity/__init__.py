"""Where linear analysis holds over a grid of bumps."""
