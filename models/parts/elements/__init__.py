"""Force elements for sections of `[parts]`, each in its own file."""
