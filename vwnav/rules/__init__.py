"""What holds for every flight, in temporal form, over a neutral log of it."""
