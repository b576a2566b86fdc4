"""The trade-off between two or three demands: designs of which none is better than another in all, and what bounds them."""
