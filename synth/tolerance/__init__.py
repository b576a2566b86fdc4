"""What is true of a law whose readings and forces are off: its worst norm over a box of errors, and how much it bears."""
