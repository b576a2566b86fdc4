"""What is true of a gain, by numpy alone: LMI (20), two norms, lower bounds, the record of a proof."""
