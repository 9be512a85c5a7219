"""Exact programmes that prove optima."""
