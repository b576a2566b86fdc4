"""Adjustable (semi-active) dampers: what they are, and the laws that ship for them."""
