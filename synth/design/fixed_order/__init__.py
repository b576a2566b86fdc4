"""Laws with a given order or structure. The search treats a law with states as a static gain of a larger plant."""
