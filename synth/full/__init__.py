"""Full-order design: by Riccati equations, and by descent where they end far from what no controller beats; ways by name."""
