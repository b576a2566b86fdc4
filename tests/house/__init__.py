"""The repository itself: rooms, ceilings, pages, public names, sentences."""
