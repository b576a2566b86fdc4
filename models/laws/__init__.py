"""Laws of controllers: linear, semi-active, and in Python of the user's own; previews; what a controller's section asks for."""
