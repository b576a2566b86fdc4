"""Does a log still prove what it claims; without any solver."""
