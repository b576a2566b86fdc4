"""Python of the user's own: how it is named in a vehicle file, and how it is run."""
