"""One gain for a family of plants: the two steps with a slack variable in the place of a common X."""
