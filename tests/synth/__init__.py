"""Norms, bounds, designs of controllers, and what is proved of them."""
