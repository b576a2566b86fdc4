"""What acted in a run beside its signals: loads on the body, and what dampers and springs pulled with."""
