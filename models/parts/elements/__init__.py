"""Force elements that a section of `[parts]` can be: one file for each."""
