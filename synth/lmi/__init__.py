"""Problems (22) and (25) and the full-order pair along their central paths, and the same by Clarabel."""
