"""One norm as small as it can be within bounds on others, for one plant or several, with errors."""
