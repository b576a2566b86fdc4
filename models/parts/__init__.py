"""What a kind of vehicle is put together from, and what of it knows no other part."""
