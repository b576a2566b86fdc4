"""Laws of a given order or structure, from one search: a law with states is a static gain of a larger plant."""
