"""Figures as data, and their drawing: by matplotlib, or as SVG on a page."""
