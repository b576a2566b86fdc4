"""Vehicle types: equations of motion, parameters and signals, for built-in and custom vehicle types."""
