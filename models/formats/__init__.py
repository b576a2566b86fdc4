"""Formats of files from elsewhere, read as what they are: numbers."""
