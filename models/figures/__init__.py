"""Figures as data; drawn by matplotlib, or as a page."""
