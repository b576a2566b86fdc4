"""Results as documents, and figures as data. Figures are drawn by matplotlib, or by a page as SVG."""
