"""Semi-active laws that ship, on the vehicles that they are run on."""
