"""What the commands that record can be asked for: their options, and what a log of such options holds."""
