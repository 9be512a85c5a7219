"""Driving: what drivers learn from maps."""
