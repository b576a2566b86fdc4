"""What the designs of one vehicle file share, and what is made of one that is there."""
