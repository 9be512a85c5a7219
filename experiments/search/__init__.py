"""Searches: their speed, proven optima, and other libraries' searches."""
