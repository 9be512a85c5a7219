"""Styles of maps, each a TOML file with the settings of a search."""
