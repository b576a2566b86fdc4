"""Results as documents, and figures as data. Figures are drawn by matplotlib, or as SVG on a page."""
