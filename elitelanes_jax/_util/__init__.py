"""Helpers that know nothing of road networks."""
