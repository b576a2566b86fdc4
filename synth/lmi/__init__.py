"""Problems (22) and (25): their barriers, their central path, and the same by Clarabel."""
