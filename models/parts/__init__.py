"""Parts of a suspension: one class for each type of force between body and wheel. A registry lists the classes of parts."""
