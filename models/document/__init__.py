"""Documents that present results, and figures that are stored as data. Figures are drawn by matplotlib, as picture files and as
SVG in pages.
"""
