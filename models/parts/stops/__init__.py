"""Bump stops: keys and tables in vehicle files, forces, and the parts of the suspension that represent them."""
