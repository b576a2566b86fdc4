"""Laws of controllers: linear, semi-active, and in Python of the user's own, which is run here."""
