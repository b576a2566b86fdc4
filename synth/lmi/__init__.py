"""Problems (22) and (25): barriers, central paths, and solutions by Clarabel."""
