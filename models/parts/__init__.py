"""Parts of a suspension: one class for each force between body and wheel, and the registry of these classes."""
