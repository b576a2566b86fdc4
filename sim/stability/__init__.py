"""How much the loop bears: predicted, then found by bisection."""
