"""All of it for one vehicle on one page."""
