"""Force elements for sections of `[parts]`, one per file."""
