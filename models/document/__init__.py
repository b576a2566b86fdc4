"""Results as documents, and figures as data. Figures are drawn by matplotlib, as picture files and as SVG in pages."""
