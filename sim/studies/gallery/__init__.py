"""The gallery: numbers that others printed, and what comes out here."""
